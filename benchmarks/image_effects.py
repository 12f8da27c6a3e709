"""Diagnose images with hidden effects of image formation (6 s of CPU time for a case).

Objects are modules of the Catphan 504 and the ACR 464, with attenuation from xraylib. Sinograms are
projections of voxels by ASTRA or XCIST; scikit-image reconstructs them. Virtual Phantom only starts XCIST. A group of k
effects that are named as equal scores 1/k. A case depends on its simulator, seed, kind and number only. Finished cases
in the output are not repeated. Seeds 1, 5353 and 8311 to 8314 were used for development; FINAL_SEEDS were not.
"""

from pathlib import Path

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
from virtual_phantom.diagnosis.images.prepared import prepare
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.effect import DIFFERENT_SLICES, image_effects, load
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.shapes import ShapesScene
from virtual_phantom.physics.state import AIR
from virtual_phantom.proof.hiding.xcist import Materials, Scan, attenuation_per_mm, simulate
from virtual_phantom.proof.scoring.verdicts import named_groups
from virtual_phantom.reconstruction.images import reconstruct_hu

ONE_THREAD = True
FINAL_SEEDS = {"xcist": 8315, "astra": 8316}
OBJECTS = ("catphan504_ctp404", "acr464_module1")
KEV, COLUMNS, MM, VIEWS, SLICES, PHOTONS = 60.0, 75, 3.0, 120, 8, 1e5
POSITION = (np.arange(COLUMNS) - COLUMNS // 2) * MM
ANGLES = np.arange(VIEWS) * 2 * np.pi / VIEWS
FAR_MM = 2e5  # from XCIST's source to the object: rays are parallel within 0.06 mm
VOXEL_MM = 0.25  # of objects for ASTRA and XCIST
NOTHING = 10  # cases without effect for each case of the other kinds
WATER = xraylib.CS_Total_CP("H2O", KEV) / 10  # per mm
FILTERS = ("shepp-logan", "cosine", "hamming", "hann")
FURTHER = ("scatter", "spectrum")  # candidates beside the effects on images
# Effect that a kind of case hides; other kinds have the name of the effect.
EFFECT = dict.fromkeys(FILTERS, "reconstruction_kernel") | {"boost": "reconstruction_kernel"}
KINDS = (
    *FILTERS,
    "boost",
    "residual_cupping",
    "crescent",
    "truncation",
    "contrast_dependent_resolution",
    "resampling",
    "hu_calibration",
    "rings",
    "hann+crescent",
    "cosine+hu_calibration",
    "boost+residual_cupping",
    "hamming+rings",
    "crescent+hu_calibration",
    "hann+truncation",
    "resampling+residual_cupping",
    "contrast_dependent_resolution+hu_calibration",
    "nothing",
)
FIELDS = ["kind", "object", "number", "verdict", "named", "group", "score", "intervals", "covered", "values"]


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


def mean_transmission(lines):
    """Line integrals of columns, from those of equal numbers of rays in each, shape (views, rays)."""
    return -np.log(np.exp(-lines).reshape(VIEWS, COLUMNS, -1).mean(axis=2))


def voxels(name):
    """Attenuation per mm, shape (y, x), with partial volumes at edges."""
    count = round(COLUMNS * MM / VOXEL_MM)
    axis = (np.arange(count) - (count - 1) / 2) * VOXEL_MM
    found = np.zeros((count, count))
    for x, y, radius, mu in circles(name):
        share = np.clip((radius - np.hypot(axis - x, axis[:, None] - y)) / VOXEL_MM + 0.5, 0, 1)
        found += share * (mu - found)
    return found


def by_astra(name):
    """Line integrals of voxels by ASTRA, shape (views, columns), mean transmission of one ray per voxel."""
    import astra

    mu = voxels(name)
    half = len(mu) * VOXEL_MM / 2
    volume = astra.create_vol_geom(*mu.shape, -half, half, -half, half)
    detector = astra.create_proj_geom("parallel", VOXEL_MM, len(mu), -ANGLES)
    projector = astra.create_projector("linear", detector, volume)
    number, lines = astra.create_sino(mu[::-1], projector)
    astra.data2d.delete(number)
    astra.projector.delete(projector)
    return mean_transmission(lines)


def by_xcist(name, random):
    """Noisy line integrals of voxels by XCIST, shape (slices, views, columns)."""
    water = attenuation_per_mm("water", KEV)
    scanned = Materials({"water": (voxels(name) / WATER)[None].astype(np.float32)}, (VOXEL_MM, 10 * MM))
    scan = Scan(VIEWS, COLUMNS, 1, MM, MM, FAR_MM, FAR_MM + 1, kev=KEV, photons=PHOTONS)
    taken = simulate(scan, scanned, SLICES, np.random.SeedSequence(int(random.integers(2**31))))
    lines = -np.log(np.maximum(taken.readings, 1e-6) / taken.air)[:, :, 0]
    return lines[:, -np.arange(VIEWS)] * WATER / water  # XCIST rotates in the other direction


def by_poisson(lines, random):
    """Noisy line integrals, shape (slices, views, columns)."""
    counts = random.poisson(PHOTONS * np.exp(-lines), (SLICES, *lines.shape))
    return -np.log(np.maximum(counts, 0.5) / PHOTONS)


def back_projected(lines, filter_name):
    """Image of line integrals, shape (views, columns), per mm."""
    return iradon(lines.T / MM, np.rad2deg(ANGLES), filter_name=filter_name, circle=True)


def changed_lines(lines, kind, size, random, filter_name, values):
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
        values["rms"] = 1000 / WATER * back_projected(errors, filter_name)[inside].std()
        return lines + errors
    if kind == "truncation":
        values["radius_mm"] = MM * (random.integers(23, 32) + 0.5)  # edge of the last element
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


def recorded(simulator, kind, number, seed):
    """Slices (slices, 1, rows, columns) of a case in HU, its object, and the true values by parameter."""
    random = np.random.default_rng(np.random.SeedSequence([seed, KINDS.index(kind), number]))
    name, kinds, values = OBJECTS[(number + KINDS.index(kind)) % 2], kind.split("+"), {}
    size, pixel = random.uniform(0.7, 1.5), random.uniform(1.5, 3.5)
    filter_name = next((one for one in kinds if one in FILTERS), "hann" if "boost" in kinds else "ramp")
    if simulator == "xcist":
        noisy = by_xcist(name, random)
        for one in kinds:
            noisy = changed_lines(noisy, one, size, random, filter_name, values)
    else:
        lines = by_astra(name)
        for one in kinds:
            lines = changed_lines(lines, one, size, random, filter_name, values)
        noisy = by_poisson(lines, random)
    noisy[..., np.abs(POSITION) > values.get("radius_mm", np.inf)] = 0
    image = 1000 * (np.stack([back_projected(one, filter_name) for one in noisy]) / WATER - 1)
    for one in kinds:
        image = changed_image(image, one, size, pixel, values)
    return image[:, None].astype(np.float32), name, values


def diagnosed(case):
    """The row of one case, in a list."""
    simulator, kind, number, seed, wanted = case
    images, name, values = recorded(simulator, kind, number, seed)
    detector = dict(columns=COLUMNS, rows=1, column_pitch_mm=MM, row_pitch_mm=MM)
    geometry = circular(views=VIEWS, **parallel_beam(), **detector)
    grid = Grid(images.shape[1:], (MM, MM, MM))
    chains = model_and_floor(ShapesScene(read_object(name).shapes, KEV), geometry, 16, readout=AIR)
    seen_mm = values.get("radius_mm", -POSITION[0])  # scanners show nothing outside the field of view
    valid = np.broadcast_to(np.hypot(POSITION[:, None], POSITION) < seen_mm - MM, grid.shape)

    def reconstruct(lines, **filters):
        how = "fbp", FbpSettings("coverage"), "cpu", WATER
        return reconstruct_hu(lines.astype(np.float32), geometry, grid, *how, **filters)

    random = np.random.SeedSequence(seed)
    options = {"slices_variance": 1.0, "filters": True}
    prepared = prepare(images, None, *chains, reconstruct, grid.spacing, valid, random, **options)
    content = find_missing_physics(kind, prepared, wanted, defaults_of("diagnosis", "model_accuracy")).content
    named, groups = [one["name"] for one in content["effects"]], named_groups(content)
    truths = [EFFECT.get(one, one) for one in kind.split("+")]
    shares = [max((1 / len(group) for group in groups if truth in group), default=0) for truth in truths]
    if len(truths) == 1:  # the first effect counts
        shares = [1 / len(group) if truths[0] in group else 0 for group in groups[:1]]
    known = {
        key: value["ci95"]
        for one in content["effects"]
        for key, value in one["parameters"].items()
        if one["name"] in truths
    }
    held = {key: known[key] for key in values if key in known}
    covered = sum(low <= values[key] <= high for key, (low, high) in held.items())
    texts = [f"{key} {low:.5g} to {high:.5g}, true {values[key]:.5g}" for key, (low, high) in held.items()]
    row = {
        "kind": kind,
        "object": name,
        "number": number,
        "verdict": content["verdict"],
        "named": " + ".join(named),
        "group": " ".join(sorted(set().union(*groups[: len(truths)]))),
        "score": f"{np.prod(shares) if shares else 0:.3g}",
        "intervals": len(held),
        "covered": covered,
        "values": "; ".join(texts),
    }
    return [row]


def add_arguments(parser):
    common.add_realizations(parser, 1, out="image_effects.csv")
    parser.add_argument("--simulator", choices=("astra", "xcist"), required=True)
    parser.add_argument("--seed", type=int, default=1, help=f"final cases: {FINAL_SEEDS}")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))


def run(options):
    wanted = tuple(name for name in (*image_effects(), *FURTHER) if DIFFERENT_SLICES not in load(name).needs)
    numbers = range(options.first, options.first + options.draws)
    drawn = [(kind, number) for number in numbers for kind in options.kinds if kind != "nothing"]
    if "nothing" in options.kinds:
        drawn += [("nothing", NOTHING * number + one) for number in numbers for one in range(NOTHING)]
    np.random.default_rng(options.seed).shuffle(drawn)
    rows = common.read_csv_rows(Path(options.out))
    done = {(row["kind"], int(row["number"])) for row in rows}
    cases = [(options.simulator, *one, options.seed, wanted) for one in drawn if one not in done]
    for (row,) in common.parallel_rows(diagnosed, cases, options, FIELDS, append=True):
        rows.append(row)
        print(", ".join(str(value) for value in row.values()), flush=True)
    pairs = [float(row["score"]) for row in rows if "+" in row["kind"]]
    single = [float(row["score"]) for row in rows if "+" not in row["kind"] and row["kind"] != "nothing"]
    nothing = [row for row in rows if row["kind"] == "nothing"]
    print(f"named first: {sum(single):.1f} of {len(single)}; both of two: {sum(pairs):.1f} of {len(pairs)}")
    further = [row for row in rows if row["kind"] != "nothing" and row["named"].count("+") > row["kind"].count("+")]
    print(
        f"false alarms: {sum(bool(row['named']) for row in nothing)} of {len(nothing)}; further effects: {len(further)}"
    )
    covered, intervals = (sum(int(row[key]) for row in rows) for key in ("covered", "intervals"))
    print(f"intervals that cover: {covered} of {intervals}")
