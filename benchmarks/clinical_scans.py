"""Diagnose clinical scans that XCIST simulates, with one hidden effect each (2 hours).

XCIST scans a body of surfaces with the geometry and physics of a GE LightSpeed VCT. Each case is written as
DICOM-CT-PD, imported, and diagnosed by the commands of the project, with the physics that a physicist would declare for
the scanner. In half of the cases one effect of the scanner is not declared; in the others an additional effect is
hidden. Cases in the output folder are not repeated.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import yaml

from benchmarks import common
from virtual_phantom.base.geometry import circular
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.io import dicom_ct_pd as pd
from virtual_phantom.io.dicom_export import write
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.xcist import TARGET_ANGLE_DEG, Scan, simulate
from virtual_phantom.proof.hiding.xcist_surfaces import CYLINDER, ELLIPSOID, Surface, Surfaces

DETECTOR = common.LIGHTSPEED | {"rows": 16, "surface": "cylindrical"}
VIEWS, ROTATION_MS, PHOTONS = 246, 1000.0, 3e5  # per turn, a quarter of the scanner's 984
SENSOR = "yttrium_gadolinium_oxide"  # the simulator's Lumex
LEAST_READING = 1e-6  # of the air scan
# XCIST's material: the library's material; attenuations agree within 0.2 %.
MATERIALS = {"water": "water", "plexi": "pmma", "Al": "aluminium", "air": "air"}
# Kind, material, center and half-axes (mm) of a body of 260 x 190 mm with inserts.
BODY = (
    Surface(CYLINDER, "water", (0, 0, 0), (130, 95, 1000)),
    Surface(CYLINDER, "plexi", (-70, 15, 0), (20, 20, 1000)),
    Surface(CYLINDER, "Al", (75, -25, 0), (6, 6, 1000)),
    Surface(CYLINDER, "air", (30, 50, 0), (14, 14, 1000)),
    Surface(ELLIPSOID, "Al", (5, -40, 1), (12, 12, 5)),
    Surface(ELLIPSOID, "plexi", (-20, 55, -2), (16, 16, 6)),
)
# The scanner: settings of the simulator, and declared parameters (value, SD; 0: exact). The bowtie's profile comes from
# its file. The filtration hardens the central ray as the file's spectrum, 3 mm of aluminum and the bowtie's 2.6 mm do.
# The sensor's thickness is uncertain: the simulator's sensor keeps all energy, the library's loses fluorescence.
SCANNER = {
    "spectrum": (
        {"kvp": 120.0, "aluminium_mm": 3.0},
        {"kvp": (120.0, 0.0), "filtration_mm": (10.8, 1.0), "sensor_mm": (3.0, 1.5)},
    ),
    "bowtie": (
        {"bowtie": "large", "bowtie_scale": 1.0},
        {"at_20deg_mm": (31.8, 1.0), "exponent": (3.54, 0.0), "levels_off_deg": (14.9, 0.0)},
    ),
    "focal_spot": ({"focal_spot_mm": (1.3, 1.3)}, {"width_mm": (1.3, 0.0), "length_mm": (1.3, 0.0)}),
    "xray_crosstalk": ({"crosstalk": (0.025, 0.02)}, {"column": (0.025, 0.0), "row": (0.02, 0.0)}),
    "optical_crosstalk": ({"optical_crosstalk": (0.04, 0.03)}, {"column": (0.04, 0.0), "row": (0.03, 0.0)}),
}
# Additional effects.
BESIDE = ("scatter", "afterglow", "motion", "detector_offset", "current_modulation", "view_angle_error")


def case(number: int, seed: int) -> dict:
    """Hidden effect of a case: an effect of the scanner in even cases, an additional effect in odd ones."""
    random = generator(branch(seed, number))
    if number % 2 == 0:
        return {"hidden": list(SCANNER)[number // 2 % len(SCANNER)], "settings": {}, "comparable": {}}
    order = generator(branch(seed, 1000)).permutation(len(BESIDE))
    name = BESIDE[order[number // 2 % len(BESIDE)]]
    strength = str(random.choice(["medium", "strong"]))
    settings, comparable = CATALOGUE[name].draw(strength, random)
    return {"hidden": name, "strength": strength, "settings": settings, "comparable": comparable}


def scanned(one: dict, number: int, seed: int):
    settings = {key: value for made, _ in SCANNER.values() for key, value in made.items()} | one["settings"]
    scan = Scan(VIEWS, kev=60.0, photons=PHOTONS, rotation_ms=ROTATION_MS, settings=settings, **DETECTOR)
    return simulate(scan, Surfaces(BODY, cells_divided=(4, 4)), 1, branch(seed, number, 1))


def write_dicom(taken, folder: Path) -> None:
    """One file per view, with the noise-equivalent quanta of every column in air."""
    geometry = circular(views=VIEWS, view_interval_ms=ROTATION_MS / VIEWS, **DETECTOR)
    readings = np.maximum(taken.readings[0], LEAST_READING * taken.air)
    quanta = [float(value) for value in taken.quanta.mean(axis=0)]
    for number, view in enumerate(pd.views_of(-np.log(readings / taken.air), geometry), start=1):
        view.KVP = 120
        view.add_new(pd.PHOTONS, "FL", quanta)
        write(view, folder / f"view{number:06d}.dcm")


def state_tube(path: Path) -> None:
    """Add the anode, for which DICOM-CT-PD has no element, to the recording."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["nominal"] |= {"anode": "W", "anode_angle_deg": TARGET_ANGLE_DEG, "sensor": {"material": SENSOR}}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def write_object(path: Path) -> None:
    """Write the body as shapes; a long ellipsoid replaces the elliptic cylinder."""
    shapes = []
    for one in BODY:
        ellipsoid = one.kind == "ellipsoid" or one.half_axes_mm[0] != one.half_axes_mm[1]
        size = {"semi_axes_mm": list(one.half_axes_mm)} if ellipsoid else {"diameter_mm": 2 * one.half_axes_mm[0]}
        shape = {"kind": "ellipsoid" if ellipsoid else "cylinder", "material": MATERIALS[one.material]}
        shapes.append(shape | {"centre_mm": list(one.centre_mm)} | size)
    content = {"description": "A body with inserts.", "sources": ["made up"], "shapes": shapes}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def write_config(one: dict, folder: Path, view_step: int) -> Path:
    """Write the configuration of the diagnosis, which declares all effects of the scanner but the hidden one."""
    baseline = {
        name: {key: {"value": value, "sd": sd} for key, (value, sd) in stated.items()}
        for name, (_, stated) in SCANNER.items()
        if name != one["hidden"]
    }
    settings = {"object": {"kind": str(folder / "body.yaml")}, "baseline": baseline, "view_step": view_step}
    settings["samples"] = 2  # per direction; the focal spot has points of its own
    config = {
        "results_dir": str(folder / "results"),
        "recordings": {"clinic": str(folder / "recording")},
        "diagnosis": {"recordings": {"clinic": settings}},
    }
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    return path


def done(command: list[str]) -> None:
    """Run a command of the project in its root."""
    subprocess.run(command, cwd=common.ROOT, check=True, stdout=subprocess.DEVNULL)


def diagnosed(number: int, options) -> dict:
    """Simulate, import and diagnose a case."""
    folder = (options.out / f"case{number:02d}").resolve()
    path = folder / "results" / "diagnosis" / "clinic" / "diagnosis.json"
    one = case(number, options.seed)
    began = time.perf_counter()
    if not path.is_file():
        if not (folder / "recording").is_dir():
            write_dicom(scanned(one, number, options.seed), folder / "dicom")
            importer = Path(sys.executable).with_name("virtual-phantom-import")
            done([str(importer), "dicom-ct-pd", str(folder / "dicom"), str(folder / "recording")])
            state_tube(folder / "recording" / "recording.yaml")
        write_object(folder / "body.yaml")
        config = write_config(one, folder, options.view_step)
        snakemake = str(Path(sys.executable).with_name("snakemake"))
        done([snakemake, "diagnosis", "--cores", str(options.cores), "--configfile", str(config)])
    document = json.loads(path.read_text(encoding="utf-8"))
    return one | {"said": document, "seconds": time.perf_counter() - began}


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--view-step", type=int, default=15, help="distance of the views that are fitted or held out")
    parser.add_argument("--cores", type=int, default=2, help="cores of one diagnosis")
    parser.add_argument("--out", type=Path, required=True, help="folder of the cases; finished ones are kept")


def run(options):
    first = 0
    for number in range(options.first, options.first + options.cases):
        one = diagnosed(number, options)
        named = [effect["name"] for effect in one["said"]["effects"]]
        right = named[:1] == [one["hidden"]]
        first += right
        print(f"{number}: {one['hidden']}: {one['said']['sentence']} [{one['seconds']:.0f} s]", flush=True)
    print(f"named first in {first} of {options.cases}")
