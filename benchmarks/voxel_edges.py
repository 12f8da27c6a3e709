"""Diagnose scans of sharp-edged bodies, described by voxels of up to twice the width of a pixel (20 minutes of CPU).

The scanned bodies are of shapes with exact path lengths. The diagnosis gets labels, shares of voxels, or HU. Widths are
in pixels at the isocenter. Finished cases of the output file are not repeated. Development seeds were 101 and 102.
"""

import os
import tempfile
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import chain_scans, circular_scan
from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.projections.object_errors import StatedObject
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.scanned_object import coarse_scene
from virtual_phantom.diagnosis.settings import ObjectUncertainty
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.beam.materials import Segmentation, attenuation_per_mm, energy_of
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.physics.scenes.shapes import ShapesScene, ellipsoid

NONE = "none"
EFFECTS = ("scatter", "spectrum", "focal_spot", "detector_offset", "xray_crosstalk", "dark_signal")
FORMS = ("labels", "shares", "hu")
MU_WATER = 0.0193
ENERGY_KEV = energy_of("water", MU_WATER)
SEGMENTATION = Segmentation()
GEOMETRY = circular_scan(60, 64, 4, 1040 / 570, view_interval_ms=10.0)  # pixels of 1 mm at the isocenter
EXTENT_MM = (12.0, 44.0, 60.0)
EXACT_SAMPLES, SAMPLES = 8, 2  # rays per pixel and direction
POINTS = (4, 8, 8)  # per voxel along z, y and x, for its shares
KEYS = ("seed", "body", "form", "width", "photons", "repeats", "hidden", "snr")
FIELDS = (*KEYS, "verdict", "named", "right", "unexplained", "cpu_s")


def body(random):
    """An elliptic body of water with three balls or rods, as (material, center, half axes)."""
    tall = 1000.0
    found = [("water", (0, 0, 0), (random.uniform(23, 27), random.uniform(16, 20), tall))]
    for material, angle in zip(
        ("bone", "pmma", "adipose"), random.uniform(0, 0.6) + np.array([0, 2.1, 4.2]), strict=True
    ):
        at = 10 * np.array([np.cos(angle), 0.8 * np.sin(angle), 0])
        radius = random.uniform(3, 6)
        found.append((material, at, (radius, radius, radius if material == "pmma" else tall)))
    return found


def told(shapes, width, form, random, folder):
    """Scene of voxels at a random position of the grid, and the other arguments of `prepare`."""
    shape = tuple(int(np.ceil(extent / width)) + 1 for extent in EXTENT_MM)
    grid, shift = Grid(shape, (width,) * 3), random.uniform(-0.5, 0.5, 3) * width
    points = POINTS if form != "labels" else (1, 1, 1)
    fine = Grid(tuple(map(int, np.multiply(points, shape))), tuple(width / count for count in points))
    z, y, x = np.meshgrid(*fine.axes_mm(), indexing="ij", sparse=True)
    blocks = np.zeros((len(shapes), *shape), np.float32)
    for layer in range(shape[0]):
        here = x, y, z[layer * points[0] : (layer + 1) * points[0]]
        index = np.full((points[0], *fine.shape[1:]), -1, np.int8)
        for number, (_, at, axes) in enumerate(shapes):
            terms = (((a - b - c) / half) ** 2 for a, b, c, half in zip(here, at, shift, axes, strict=True))
            index[sum(terms) < 1] = number
        for number in range(len(shapes)):
            parts = (index == number).reshape(points[0], shape[1], points[1], shape[2], points[2])
            blocks[number, layer] = parts.mean(axis=(0, 2, 4))
    materials = tuple(material for material, _, _ in shapes)
    if form != "hu":
        scene = VoxelScene(blocks, grid, materials, ENERGY_KEV)
        return shift, scene, StatedObject(scene, ObjectUncertainty(), MU_WATER), None
    mu = np.tensordot([attenuation_per_mm(material, [ENERGY_KEV])[0] for material in materials], blocks, 1)
    phantom = Volume((1000 * (mu / MU_WATER - 1)).astype(np.float32), grid)
    write_nifti(phantom, folder / "phantom.nii.gz")
    scene = VoxelScene.of(phantom, SEGMENTATION, MU_WATER)
    coarse = coarse_scene(folder / "phantom.nii.gz", MU_WATER, SEGMENTATION)
    return shift, scene, StatedObject(scene, ObjectUncertainty(), MU_WATER, phantom), coarse


def true_scene(shapes, shift):
    return ShapesScene([ellipsoid(material, at + shift, axes) for material, at, axes in shapes], ENERGY_KEV)


def diagnosed(case, folder):
    random = np.random.default_rng(np.random.SeedSequence(case["seed"], spawn_key=(case["body"],)))
    shapes = body(random)
    shift, scene, uncertain, coarse = told(shapes, case["width"], case["form"], random, folder)
    exact, photons, physics = true_scene(shapes, shift), case["photons"], {}
    if case["hidden"] != NONE:
        blank = prepare(chain_scans.scans(chain(exact, photons), {}, random), exact, photons)
        physics = {case["hidden"]: chain_scans.strengths(case["hidden"], case["snr"], random, blank)}
    taken = chain_scans.scans(chain(exact, photons), physics, random, repeats=case["repeats"])
    began = sum(os.times()[:4])
    data = prepare(taken, scene, photons, uncertain=uncertain, coarse=coarse)
    found = find_missing_physics("scan", data, chain_scans.LIBRARY, defaults_of("diagnosis", "model_accuracy"))
    return physics, found, round(sum(os.times()[:4]) - began, 1)


def chain(scene, photons):
    return Chain(scene, GEOMETRY, photons, samples=EXACT_SAMPLES)


def prepare(taken, scene, photons, coarse=None, **options):
    model, floor = model_and_floor(scene, GEOMETRY, SAMPLES, photons=photons)
    if coarse is not None:
        options["coarse_chain"] = Chain(coarse, GEOMETRY, samples=SAMPLES)
    return prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=photons, **options)


def row_of(case):
    with tempfile.TemporaryDirectory() as folder:
        physics, diagnosis, seconds = diagnosed(case, Path(folder))
    content = diagnosis.content
    named = [found["name"] for found in content["effects"]]
    right = named[:1] == [case["hidden"]] if physics else content["verdict"] == "match"
    left = "+".join(f"{place['domain']} {place['z']:.1f}" for place in content["unexplained"])
    return case | {
        "verdict": content["verdict"],
        "named": "+".join(named),
        "right": int(right),
        "unexplained": left,
        "cpu_s": seconds,
    }


def cases(options):
    for seed, number, dose, width, form in product(
        options.seeds, range(options.bodies), options.doses, options.widths, options.forms
    ):
        photons, _, repeats = dose.partition("x")
        scan = {"seed": seed, "body": number, "form": form, "width": width}
        scan |= {"photons": float(photons), "repeats": int(repeats)}
        if options.none:
            yield scan | {"hidden": NONE, "snr": 0.0}
        for effect, snr in product(options.effects, options.snr):
            yield scan | {"hidden": effect, "snr": snr}


def add_arguments(parser):
    parser.add_argument("--seeds", nargs="*", type=int, default=[7203])
    parser.add_argument("--bodies", type=int, default=2)
    parser.add_argument("--forms", nargs="*", default=list(FORMS), choices=FORMS)
    parser.add_argument("--widths", nargs="*", type=float, default=[0.5, 1.0, 2.0], help="of voxels, in pixels")
    parser.add_argument("--doses", nargs="*", default=["1e5x4"], help="photons per pixel in air x repeats")
    parser.add_argument("--none", type=int, default=1, help="0: no scan without a hidden effect")
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS))
    parser.add_argument("--snr", nargs="*", type=float, default=[50.0], help="of the hidden effect beyond alignment")
    parser.add_argument("--out", type=Path, default=Path("voxel_edges.csv"))


def key_of(row):
    return tuple(str(row[name]) for name in KEYS)


def run(options):
    rows = common.read_csv_rows(options.out)
    done = set(map(key_of, rows))
    with common.csv_writer(options.out, FIELDS, append=True) as write:
        for case in cases(options):
            if key_of(case) not in done:
                row = row_of(case)
                write(row)
                rows.append({key: str(value) for key, value in row.items()})
                print(*row.values(), sep=", ", flush=True)
    for keys in (("form", "width"), ("photons", "repeats"), ("hidden",)):
        for hidden in (False, True):
            counts = {}
            for row in rows:
                if (row["hidden"] != NONE) == hidden:
                    counts.setdefault(tuple(row[key] for key in keys), []).append(int(row["right"]))
            for values, right in counts.items():
                print(f"{'hidden' if hidden else 'null'}, {', '.join(values)}: {sum(right)} of {len(right)}")
