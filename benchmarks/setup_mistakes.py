"""Count how often scan set-up errors are named, and how often correct set-ups are accepted (10 minutes).

Each scan has a random geometry, object and position, and physics that the comparison does not model. Each kind of error
is made in the set-up or in the data. Kind `none` has no error, `object` compares with another object, and `hidden` has
an error that a centered disc cannot show. An impossible set-up counts as named if the error message says what to
change.
"""

import csv
import sys
import time
from collections import Counter

import numpy as np
from scipy import ndimage

from benchmarks import common
from benchmarks.common import chain_scans
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import Stream, generator
from virtual_phantom.diagnosis.setup.finding import AS_STATED, DESCRIPTION, MOST, OBJECT, find
from virtual_phantom.diagnosis.setup.mismatch import Comparison
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.scan import scan_geometry

REACH = {"x_mm": 5.0, "y_mm": 5.0, "z_mm": 5.0, "turn_deg": 2.5}
LN_10 = np.log(10)
# Physics that the comparison does not model; two per realization.
PHYSICS = (
    {"spectrum": {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}},
    {"scatter": {"amount": 0.1, "width_mm": 40.0}},
    {"focal_spot": {"width_mm": 1.2, "length_mm": 1.2}},
    {"detector_offset": {"columns_px": 0.3}},
    {"veiling_glare": {"share": 0.05, "width_mm": 60.0, "beyond": 0.0}},
    {"optical_crosstalk": {"column": 0.05, "row": 0.05}},
    {"afterglow": {"share": 0.05, "time_constant_ms": 15.0, "before": 0.0}},
    {"centre_of_rotation": {"shift_mm": 0.4}},
)
KINDS = (
    *("none", "direction", "start angle", "mirrored columns", "mirrored rows", "swapped rows and columns"),
    *("pitch at the isocenter", "swapped distances", "distance from the isocenter"),
    *("last view at the angle of the first", "sign of the detector offset along columns"),
    *("transmissions", "decadic logarithm"),
)


def scene(kind, random):
    if kind == "disc":
        return DiscScene(float(random.uniform(60, 220)), "pmma")
    grid = Grid((40, 160, 160), (2.0, 1.8, 1.8))
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    long, short = random.uniform(90, 130), random.uniform(65, 95)
    hu = np.where((x / long) ** 2 + (y / short) ** 2 < 1, 20.0, -1000.0)
    if kind == "cylinder":
        hu = np.where(x**2 + y**2 < long**2, 0.0, -1000.0)
    for value in random.permutation([800.0, -80.0, 300.0, 120.0, -900.0]):
        size, angle, away = random.uniform(10, 20), random.uniform(0, 2 * np.pi), random.uniform(0.2, 0.65) * short
        height, tall = random.uniform(-12, 12), random.uniform(8, 40)
        inside = (x - away * np.cos(angle)) ** 2 + (y - away * np.sin(angle)) ** 2 < size**2
        hu = np.where(inside & (np.abs(z - height) < tall), value, hu)
    hu = ndimage.gaussian_filter(hu, 0.5, mode="nearest")
    return VoxelScene.of(Volume(hu.astype(np.float32), grid), Segmentation(), 0.0193, 2)


def scanner(random):
    """Random scan section of recording.yaml."""
    columns, rows = int(random.integers(60, 160)), int(random.integers(4, 20))
    isocentre = float(random.uniform(400, 700))
    detector = isocentre * float(random.choice([random.uniform(1.5, 1.95), random.uniform(2.1, 2.5)]))
    width = 300.0 * detector / isocentre
    views = int(random.integers(80, 240))
    return {
        "trajectory": "circular",
        "source_to_isocentre_mm": round(isocentre, 1),
        "source_to_detector_mm": round(detector, 1),
        "columns": columns,
        "rows": rows,
        "column_pitch_mm": round(width / columns, 3),
        "row_pitch_mm": round(width / columns * float(random.uniform(0.6, 1.5)), 3),
        "column_offset_px": round(float(random.choice([0.25, 1.5, -2.0, 4.0])), 2),
        "views": views,
        "views_per_rotation": views,
        "start_angle_deg": round(float(random.uniform(-180, 180)), 1),
        "direction": int(random.choice([-1, 1])),
        "view_interval_ms": 5.0,
    }


def mistaken(kind, scan, lines, random):
    """Set-up and data with an error of this kind."""
    isocentre, detector = scan["source_to_isocentre_mm"], scan["source_to_detector_mm"]
    if kind == "start angle":  # the only kind with a random size
        return {**scan, "start_angle_deg": scan["start_angle_deg"] + float(random.choice([90, 180, -90, 37]))}, lines
    described = {
        "direction": {"direction": -scan["direction"]},
        "swapped rows and columns": {"rows": scan["columns"], "columns": scan["rows"]},
        "pitch at the isocenter": {
            key: scan[key] * isocentre / detector for key in ("column_pitch_mm", "row_pitch_mm")
        },
        "swapped distances": {"source_to_isocentre_mm": detector - isocentre},
        "distance from the isocenter": {"source_to_detector_mm": detector - isocentre},
        "last view at the angle of the first": {"views_per_rotation": scan["views"]},
        "sign of the detector offset along columns": {"column_offset_px": -scan["column_offset_px"]},
    }
    data = {
        "mirrored columns": lambda: lines[..., ::-1],
        "mirrored rows": lambda: lines[..., ::-1, :],
        "swapped rows and columns": lambda: np.swapaxes(lines, -1, -2),
        "transmissions": lambda: np.exp(-lines),
        "decadic logarithm": lambda: lines / LN_10,
    }
    return scan | described.get(kind, {}), data[kind]() if kind in data else lines


# Text of the error message that names the error.
REFUSED = {
    "swapped rows and columns": "check whether rows and columns are swapped",
    "distance from the isocenter": "if it is the distance from isocenter to detector",
}
NAMED, ALIKE, MISSED = "named", "alike", "missed"


def outcome(kind, hidden, found):
    """Whether an error is named, listed as indistinguishable, or missed."""
    alternatives = {other.name for other in found.alike}
    if hidden:
        return ALIKE if found.kind == AS_STATED and kind in alternatives else MISSED
    if kind == "none":
        return NAMED if found.kind == AS_STATED else MISSED
    if kind == "object":
        return NAMED if found.kind == OBJECT else MISSED
    if found.kind == DESCRIPTION and found.best.name == kind:
        return NAMED
    return ALIKE if kind in alternatives | {found.best.name} else MISSED


def found(scene, scan, lines):
    comparison = Comparison(scene, lines, np.isfinite(lines).all(axis=0), MOST, REACH)
    return find(comparison, scan, True, float(lines.max()))


def add_arguments(parser):
    common.add_realizations(parser, 5, 0)
    parser.add_argument("--kinds", nargs="*", default=[*KINDS, "object", "hidden"])


def run(options):
    writer = csv.writer(sys.stdout)
    writer.writerow("draw kind physics said best share_stated share_best share alike seconds outcome".split())
    counted = {kind: Counter() for kind in options.kinds}
    for draw in range(options.first, options.first + options.draws):
        for kind in options.kinds:
            random = generator(Stream(draw))
            objects = [scene(str(random.choice(["body", "body", "cylinder"])), random) for _ in range(2)]
            scan = scanner(random)
            pose = Pose(*random.normal(0, (1, 1, 1, 0.3)))
            physics = {}
            for which in random.choice(len(PHYSICS), 2, replace=False):
                physics |= PHYSICS[which]
            if kind == "hidden":
                objects[0] = scene("disc", random)
                pose = Pose()
            if kind == "last view at the angle of the first":
                scan["views_per_rotation"] -= 1
            chain = Chain(objects[0], scan_geometry(scan, "scan"), samples=2)
            lines = chain_scans.scans(chain, physics, random, pose).repeats
            made = str(random.choice(["direction", "start angle"])) if kind == "hidden" else kind
            described, data = mistaken(made, scan, lines, random)
            began = time.process_time()
            try:
                one = found(objects[1] if kind == "object" else objects[0], described, data)
            except InputError as error:  # an impossible set-up
                came = NAMED if kind in REFUSED and REFUSED[kind] in str(error) else MISSED
                counted[kind][came] += 1
                writer.writerow((draw, kind, "+".join(physics), "refused", str(error), "", "", "", "", "", came))
                continue
            seconds = time.process_time() - began
            alternatives = " | ".join(other.name for other in one.alike)
            row = (draw, made if kind == "hidden" else kind, "+".join(physics), one.kind, one.best.name)
            shares = (f"{value:.2g}" for value in (one.stated.share, one.best.share, one.share))
            came = outcome(made, kind == "hidden", one)
            counted[kind][came] += 1
            writer.writerow((*row, *shares, alternatives, f"{seconds:.1f}", came))
            sys.stdout.flush()
    for kind, outcomes in counted.items():
        print(f"{kind}: " + ", ".join(f"{came} {outcomes[came]}" for came in (NAMED, ALIKE, MISSED)), file=sys.stderr)
