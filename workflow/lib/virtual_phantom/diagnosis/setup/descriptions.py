"""List possible mistakes in the scan section of recording.yaml, each with its correction and the line to change.

The check of the scan set-up tests which correction explains the recorded data better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...base.geometry import PARALLEL
from ...base.vectors import CYLINDRICAL, FLAT
from ..projections.observed import LEAST_TRANSMISSION

STATED = "as stated"
LN_10 = math.log(10)
# Data with larger values cannot be transmissions, which are 1 in air apart from noise.
LARGEST_TRANSMISSION = 1.5


@dataclass(frozen=True)
class Description:
    """A scan as described in recording.yaml, or with one mistake corrected.

    Attributes
    ----------
    name : str
        Name of the mistake; STATED for none.
    line : str
        Text that tells the user what to change.
    scan : mapping
        Section `scan` with the change.
    axes : callable
        Correction of the order of rays, shape (..., views, rows, columns).
    values : callable
        Correction of line integrals.
    oriented : bool
        Whether start angles are searched too, as mistakes of direction or axes often come with another start angle.
    shifts : bool
        Whether the mistake only shifts the detector, which an effect can also explain.
    scaled : float or None
        Factor of the line integrals, if the correction changes nothing else.
    """

    name: str
    line: str
    scan: Mapping
    axes: Callable[[np.ndarray], np.ndarray] = field(default=lambda rays: rays)
    values: Callable[[np.ndarray], np.ndarray] = field(default=lambda lines: lines)
    oriented: bool = False
    shifts: bool = False
    scaled: float | None = None


def descriptions(scan: Mapping, log: bool, largest: float) -> Iterator[Description]:
    """Yield the scan as stated, then with each possible mistake corrected.

    Parameters
    ----------
    scan : mapping
        The scan section of recording.yaml.
    log : bool
        Whether the recording has line integrals; otherwise it has counts with dark and flat fields.
    largest : float
        Largest line integral.
    """
    yield Description(STATED, "", scan, oriented=True)
    yield _corrected("direction", scan, {"direction": -scan["direction"]}, oriented=True)
    yield Description(
        "mirrored columns", "mirror /exchange/data along its columns", scan, lambda rays: rays[..., ::-1], oriented=True
    )
    if scan["rows"] > 1:
        yield Description(
            "mirrored rows", "mirror /exchange/data along its rows", scan, lambda rays: rays[..., ::-1, :]
        )
        yield from _swapped(scan)
    if scan.get("beam") != PARALLEL:
        yield from _distances(scan)
        yield from _surface(scan)
    yield from _views(scan)
    yield from _offsets(scan)
    if log:
        yield from _line_integrals(scan, largest)


def _corrected(name: str, scan: Mapping, entries: Mapping[str, float], note: str = "", **more: bool) -> Description:
    """Return a description with changed values in `scan`."""
    line = ", ".join(f"scan.{key}: {value:g}" for key, value in entries.items())
    return Description(name, line + note, {**scan, **entries}, **more)


def _swapped(scan: Mapping) -> Iterator[Description]:
    words = "swap rows and columns of /exchange/data, and scan.rows and scan.columns"
    counts = {"rows": scan["columns"], "columns": scan["rows"]}
    swap = dict(axes=lambda rays: np.swapaxes(rays, -1, -2), oriented=True)
    yield Description("swapped rows and columns", words, {**scan, **counts}, **swap)
    if scan["row_pitch_mm"] != scan["column_pitch_mm"]:
        pitches = {"row_pitch_mm": scan["column_pitch_mm"], "column_pitch_mm": scan["row_pitch_mm"]}
        words += ", and scan.row_pitch_mm and scan.column_pitch_mm"
        yield Description("swapped rows, columns and pitches", words, {**scan, **counts, **pitches}, **swap)


def _distances(scan: Mapping) -> Iterator[Description]:
    isocentre, detector = scan["source_to_isocentre_mm"], scan["source_to_detector_mm"]
    magnification = detector / isocentre
    for name, factor in (("pitch at the isocenter", magnification), ("pitch magnified twice", 1 / magnification)):
        pitches = {key: scan[key] * factor for key in ("column_pitch_mm", "row_pitch_mm")}
        yield _corrected(name, scan, pitches, " (at the detector)")
    note = " (the stated value is the distance from isocenter to detector)"
    yield _corrected("swapped distances", scan, {"source_to_isocentre_mm": detector - isocentre}, note)
    yield _corrected("distance from the isocenter", scan, {"source_to_detector_mm": detector + isocentre}, note)


def _views(scan: Mapping) -> Iterator[Description]:
    turn = scan["views_per_rotation"]
    if scan["views"] == turn:
        note = " (the last view has the angle of the first)"
        yield _corrected("last view at the angle of the first", scan, {"views_per_rotation": turn - 1}, note)
    elif scan["views"] == turn + 1:
        note = " (the last view has another angle than the first)"
        yield _corrected("last view one step before the first", scan, {"views_per_rotation": turn + 1}, note)
    for factor, words in ((2, "half a turn"), (0.5, "two turns")):
        if turn * factor >= 8:
            note = f" (the views cover {words} instead of one turn)"
            yield _corrected(f"{words} instead of one", scan, {"views_per_rotation": turn * factor}, note)
    if scan["trajectory"] == "helical":
        turned = {key: -scan[key] for key in ("table_feed_mm", "start_z_mm")}
        yield _corrected("direction of the table", scan, turned)


def _surface(scan: Mapping) -> Iterator[Description]:
    """Yield the other detector surface if it changes column positions, and another order of focal spots."""
    reach = scan["columns"] / 2 * scan["column_pitch_mm"]
    radius = scan.get("arc_radius_mm") or scan["source_to_detector_mm"]
    if abs(math.atan(reach / radius) * radius - reach) > scan["column_pitch_mm"]:
        curved = scan.get("detector", FLAT) != FLAT
        other = {key: value for key, value in scan.items() if key != "arc_radius_mm"}
        name = FLAT if curved else CYLINDRICAL
        yield Description(f"{name} detector", f"scan.detector: {name}", {**other, "detector": name})
    if spots := scan.get("flying_focal_spot"):
        turned = [*spots[1:], spots[0]]
        line = "scan.flying_focal_spot: move the first position to the end"
        yield Description("order of the focal spots", line, {**scan, "flying_focal_spot": turned})


def _offsets(scan: Mapping) -> Iterator[Description]:
    for key, name in (("column_offset_px", "columns"), ("row_offset_px", "rows")):
        if offset := scan.get(key, 0.0):
            yield _corrected(f"sign of the detector offset along {name}", scan, {key: -offset}, shifts=True)


def _line_integrals(scan: Mapping, largest: float) -> Iterator[Description]:
    if largest < LARGEST_TRANSMISSION:
        yield Description(
            "transmissions",
            "store -ln(data), not the transmission itself, in /exchange/data",
            scan,
            values=lambda lines: -np.log(np.maximum(lines, LEAST_TRANSMISSION)),
        )
    yield Description(
        "decadic logarithm",
        "multiply /exchange/data by ln 10 = 2.3026 (it holds the decadic logarithm)",
        scan,
        values=lambda lines: lines * LN_10,
        scaled=LN_10,
    )
