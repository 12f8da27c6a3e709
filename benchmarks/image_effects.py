"""Diagnose images with one hidden effect of image formation (13 minutes of CPU time).

Sinograms of the Catphan 504 and ACR 464 modules are computed from chords of circles, with attenuation from xraylib and
Poisson noise, and reconstructed with scikit-image. Virtual Phantom takes no part in them. A group of k effects that are
named as equal scores 1/k. A case depends on its seed, kind and number only. Seed 1 was used for development.
FINAL_SEED was drawn afterwards.
"""

import numpy as np
import xraylib
import yaml
from scipy import ndimage
from skimage.restoration import denoise_tv_chambolle
from skimage.transform import iradon

from benchmarks import common
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.geometry import Grid, circular, parallel_beam
from virtual_phantom.base.settings import FbpSettings
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.images.prepared import prepare
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.effect import DIFFERENT_SLICES, image_effects, load
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.shapes import ShapesScene
from virtual_phantom.physics.state import AIR
from virtual_phantom.reconstruction.images import reconstruct_hu

ONE_THREAD = True
FINAL_SEED = 5353
OBJECTS = ("catphan504_ctp404", "acr464_module1")
KEV, COLUMNS, MM, VIEWS, SLICES, PHOTONS = 60.0, 75, 3.0, 120, 8, 1e5
SUBRAYS = 64
POSITION = (np.arange(COLUMNS) - COLUMNS // 2) * MM
ANGLES = np.arange(VIEWS) * 2 * np.pi / VIEWS
WATER = xraylib.CS_Total_CP("H2O", KEV) / 10  # per mm
FILTERS = ("shepp-logan", "cosine", "hamming", "hann")
FURTHER = ("scatter", "spectrum")  # candidates beside the effects on images
# Effect that a kind of case hides; other kinds have the name of the effect.
EFFECT = dict.fromkeys(FILTERS[1:], "reconstruction_kernel") | {"boost": "reconstruction_kernel"}
KINDS = (
    *FILTERS[1:],
    "boost",
    "residual_cupping",
    "crescent",
    "truncation",
    "contrast_dependent_resolution",
    "resampling",
    "hu_calibration",
    "rings",
    "nothing",
)


def circles(name):
    """Centers, radius and attenuation per mm of the cylinders of an object; later ones replace earlier ones."""
    content = yaml.safe_load((RESOURCES / "objects" / f"{name}.yaml").read_text())
    defaults = {key: one["default"] for key, one in content["parameters"].items()}
    mu = {"air": 0.0}
    for material, one in content["materials"].items():
        density = defaults.get(one["density_g_per_cm3"], one["density_g_per_cm3"])
        fractions = one.get("mass_fractions", {})
        per_density = sum(w * xraylib.CS_Total(xraylib.SymbolToAtomicNumber(z), KEV) for z, w in fractions.items())
        mu[material] = (per_density or xraylib.CS_Total_CP(one["compound"], KEV)) * density / 10
    found = []
    for shape in content["shapes"]:
        centre = shape.get("centre_mm", (0, 0, 0))[:2]
        if "distance_mm" in shape:
            angle = np.deg2rad(shape["angle_deg"])
            centre = shape["distance_mm"] * np.array([np.cos(angle), np.sin(angle)])
        found.append((*centre, shape["diameter_mm"] / 2, mu[shape["material"]]))
    return found


def sinogram(name):
    """Line integrals, shape (views, columns), mean transmission of SUBRAYS rays."""
    fine = (POSITION[:, None] + (np.arange(SUBRAYS) - (SUBRAYS - 1) / 2) * MM / SUBRAYS).ravel()
    found, before = np.zeros((VIEWS, fine.size)), []
    for x, y, radius, mu in circles(name):
        inside = [other for other in before if np.hypot(other[0] - x, other[1] - y) + radius <= other[2] + 1e-6]
        across = x * np.cos(ANGLES) - y * np.sin(ANGLES)
        chord = 2 * np.sqrt(np.maximum(radius**2 - (fine - across[:, None]) ** 2, 0))
        found += (mu - (inside[-1][3] if inside else 0.0)) * chord
        before.append((x, y, radius, mu))
    return -np.log(np.exp(-found).reshape(VIEWS, COLUMNS, SUBRAYS).mean(axis=2))


def back_projected(lines, filter_name):
    """Image of line integrals, shape (views, columns), per mm."""
    return iradon(lines.T / MM, np.rad2deg(ANGLES), filter_name=filter_name, circle=True)


def changed_lines(lines, kind, size, random, values):
    """Line integrals with a hidden effect of the raw data."""
    if kind == "residual_cupping":  # an error of second order in the water correction
        return lines + 0.01 * size * lines * (lines - lines.max())
    if kind == "crescent":  # a filter with a flat end, displaced along a cosine of the angle
        moved = 0.3 * size * np.cos(ANGLES - random.uniform(0, 2 * np.pi))[:, None]
        end = random.uniform(50, 80)
        thickness = [np.minimum(np.abs(at), end) ** 2 / 100 for at in (POSITION + moved, POSITION)]
        return lines + 0.02 * (thickness[0] - thickness[1])
    if kind == "rings":  # gain errors of detector elements
        errors = np.tile(0.006 * size * random.normal(size=COLUMNS), (VIEWS, 1))
        inside = np.hypot(POSITION[:, None], POSITION) < 95
        values["rms"] = 1000 / WATER * back_projected(errors, "ramp")[inside].std()
        return lines + errors
    if kind == "truncation":
        values["radius_mm"] = MM * (random.integers(23, 32) + 0.5)  # edge of the last element
        return np.where(np.abs(POSITION) <= values["radius_mm"], lines, 0)
    return lines


def changed_image(image, kind, size, pixel, values):
    """An image with a hidden effect of the reconstruction, HU, shape (slices, rows, columns)."""
    if kind == "boost":  # unsharp mask
        return image + 0.5 * size * (image - ndimage.gaussian_filter(image, (0, 1.5, 1.5)))
    if kind == "contrast_dependent_resolution":
        return np.stack([1000 * denoise_tv_chambolle(one / 1000, weight=0.03 * size) for one in image])
    if kind == "resampling":
        values["pixel_mm"] = pixel
        count = int(np.ceil(COLUMNS * MM / pixel / 2)) * 2
        there = (pixel * (np.arange(count) - (count - 1) / 2)) / MM + COLUMNS // 2
        back = (np.arange(COLUMNS) - COLUMNS // 2) * MM / pixel + (count - 1) / 2
        for axis in (1, 2):
            image = _interpolated(_interpolated(image, there, axis, 3), back, axis, 1)
        return image
    if kind == "hu_calibration":
        values["offset_hu"] = 10 * size
        return image + values["offset_hu"]
    return image


def _interpolated(image, positions, axis, order):
    lines = np.moveaxis(image, axis, -1)
    at = np.meshgrid(*(np.arange(n) for n in lines.shape[:2]), positions, indexing="ij")
    return np.moveaxis(ndimage.map_coordinates(lines, at, order=order, mode="nearest"), -1, axis)


def recorded(kind, number, seed):
    """Slices (slices, 1, rows, columns) of a case in HU, its object, and the true values by parameter."""
    random = np.random.default_rng(np.random.SeedSequence([seed, KINDS.index(kind), number]))
    name, size, pixel, values = OBJECTS[number % 2], random.uniform(0.7, 1.5), random.uniform(1.5, 3.5), {}
    lines = changed_lines(sinogram(name), kind, size, random, values)
    filter_name = kind if kind in FILTERS else "hann" if kind == "boost" else "ramp"
    counts = random.poisson(PHOTONS * np.exp(-lines), (SLICES, *lines.shape))
    noisy = -np.log(np.maximum(counts, 0.5) / PHOTONS)
    if kind == "truncation":
        noisy[..., np.abs(POSITION) > values["radius_mm"]] = 0
    image = [back_projected(one, filter_name) for one in noisy]
    image = changed_image(1000 * (np.stack(image) / WATER - 1), kind, size, pixel, values)
    return image[:, None].astype(np.float32), name, values


def diagnosed(case):
    """Row of one case."""
    kind, number, seed, wanted, own_simulation = case
    images, name, values = recorded(kind, number, seed)
    detector = dict(columns=COLUMNS, rows=1, column_pitch_mm=MM, row_pitch_mm=MM)
    geometry = circular(views=VIEWS, **parallel_beam(), **detector)
    grid = Grid(images.shape[1:], (MM, MM, MM))
    chains = model_and_floor(ShapesScene(read_object(name).shapes, KEV), geometry, 16, readout=AIR)
    seen_mm = values.get("radius_mm", -POSITION[0])  # scanners show nothing outside the field of view
    valid = np.broadcast_to(np.hypot(POSITION[:, None], POSITION) < seen_mm - MM, grid.shape)

    def reconstruct(lines):
        return reconstruct_hu(lines.astype(np.float32), geometry, grid, "fbp", FbpSettings("coverage"), "cpu", WATER)

    known = {}
    if own_simulation:
        image = 1000 * (back_projected(sinogram(name), "ramp") / WATER - 1)
        known = {"known_image": image[None].astype(np.float32)}
    random = np.random.SeedSequence(seed)
    prepared = prepare(images, None, *chains, reconstruct, grid.spacing, valid, random, slices_variance=1.0, **known)
    chosen = choose(prepared.fitter, trial(prepared.fitter, ()), wanted)
    content = diagnose(kind, prepared, chosen).content
    named = [one["name"] for one in content["effects"]]
    group = {named[0], *content["ambiguous_with"].get(named[0], ())} if named else set()
    truth = EFFECT.get(kind, kind)
    first = [one["parameters"] for one in content["effects"][:1] if one["name"] == truth]
    held = {key: parameters[key]["ci95"] for parameters in first for key in values}
    covered = sum(low <= values[key] <= high for key, (low, high) in held.items())
    texts = [f"{key} {low:.3g} to {high:.3g}, true {values[key]:.3g}" for key, (low, high) in held.items()]
    return {
        "kind": kind,
        "object": name,
        "number": number,
        "verdict": content["verdict"],
        "named": " + ".join(named),
        "group": " ".join(sorted(group)),
        "score": f"{1 / len(group) if truth in group else 0:.3g}",
        "intervals": len(held),
        "covered": covered,
        "values": "; ".join(texts),
    }


def add_arguments(parser):
    common.add_realizations(parser, 5, out="image_effects.csv")
    parser.add_argument("--seed", type=int, default=1, help=f"{FINAL_SEED}: final cases")
    parser.add_argument("--own-simulation", action="store_true", help="compare with images by scikit-image")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))


def run(options):
    wanted = tuple(name for name in (*image_effects(), *FURTHER) if DIFFERENT_SLICES not in load(name).needs)
    numbers = range(options.first, options.first + options.draws)
    cases = [
        (kind, number, options.seed, wanted, options.own_simulation) for number in numbers for kind in options.kinds
    ]
    fields = ["kind", "object", "number", "verdict", "named", "group", "score", "intervals", "covered", "values"]
    rows = []
    for (row,) in common.parallel_rows(_rows, cases, options, fields):
        rows.append(row)
        print(", ".join(str(value) for value in row.values()), flush=True)
    hidden = [row for row in rows if row["kind"] != "nothing"]
    alarms = [row for row in rows if row["kind"] == "nothing" and row["named"]]
    print(f"named first: {sum(float(row['score']) for row in hidden):.1f} of {len(hidden)}")
    print(f"false alarms: {len(alarms)} of {len(rows) - len(hidden)}")
    print(f"intervals that cover: {sum(row['covered'] for row in rows)} of {sum(row['intervals'] for row in rows)}")


def _rows(case):
    return [diagnosed(case)]
