"""The scan section of recording.yaml: conversion to an OrbitGeometry, and checks of its lengths and times."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from ..base.errors import InputError
from ..base.geometry import PARALLEL, OrbitGeometry, detector_and_spot_fields, with_beam
from ..base.vectors import CYLINDRICAL, FLAT

DETECTOR = ("source_to_isocentre_mm", "source_to_detector_mm", "columns", "rows", "column_pitch_mm", "row_pitch_mm")
DISTANCES = DETECTOR[:2]
REQUIRED = ("trajectory", *DETECTOR, "views", "views_per_rotation", "start_angle_deg", "direction")
HELICAL = ("table_feed_mm", "start_z_mm")
# Body CT has fans of 45 to 60 degrees and fields of view of 500 mm. Bench scanners of small objects start at about
# 80 mm. One length in centimeters among millimeters changes these by a factor of ten.
LARGEST_FAN_DEG, FIELD_OF_VIEW_MM = 120.0, (60.0, 2000.0)
DISTANCES_MM = ((100.0, 4000.0), (200.0, 5000.0))  # plausible source_to_isocentre_mm and source_to_detector_mm
SMALLEST_PITCH_MM = 0.005  # of a detector in a divergent beam
LARGEST_PIXEL_ASPECT = 5.0  # ratio of column and row pitch; a larger ratio means mixed units
TIME_TOLERANCE = 0.01  # relative; stated times may be rounded
HALF_TURN_DEG = 179.0  # less for rounded angles
ELEMENT = "element"  # value of `length_unit`
UNKNOWN = "unknown"  # value of `angles_deg`
SIZE = "size"  # value of `not_checked`
IF_RIGHT = f"(if they are: not_checked: [{SIZE}])"


def missing_for_geometry(scan: dict) -> list[str]:
    """Return the keys that an OrbitGeometry still needs; empty if the section is complete."""
    needed = (*REQUIRED, *HELICAL) if scan.get("trajectory") == "helical" else REQUIRED
    return [key for key in needed if key not in with_beam(scan)]


def scan_geometry(scan: dict, source: str, not_checked: Collection[str] = ()) -> OrbitGeometry:
    """Return the geometry that a scan section describes.

    The angle of view i is start + direction 2 pi i / views_per_rotation, or start + direction angles_deg[i]. Its source
    is at start_z + table_feed i / views_per_rotation (see geometry.py). Lengths in detector elements count as mm.

    Parameters
    ----------
    scan : dict
        The scan section. Offsets and the start_z_mm of a circular scan are 0 if absent.
    not_checked : collection of str, optional
        With SIZE, lengths of any plausible or implausible scanner are accepted.

    Raises
    ------
    InputError
        For a missing key, contradictory keys, and lengths that cannot be in mm.
    """
    if missing := missing_for_geometry(scan):
        raise InputError(f"{source}: scan.{missing[0]} is missing; a {scan.get('trajectory', '')} scan needs it")
    if scan["trajectory"] == "helical":
        if scan["table_feed_mm"] == 0:
            raise InputError(f"{source}: scan.table_feed_mm is 0 in a helical scan; set trajectory: circular")
    elif scan.get("table_feed_mm", 0) != 0:
        raise InputError(f"{source}: scan.table_feed_mm is not 0 in a circular scan; set trajectory: helical")
    check_lengths(scan, source, SIZE not in not_checked and scan.get("length_unit") != ELEMENT)
    scan = with_beam(scan)
    interval, exposure = view_times(scan, source)
    turns = np.arange(scan["views"]) / scan["views_per_rotation"]
    angles = _angles(scan, turns, source)
    if "arc_radius_mm" in scan and scan.get("detector") != CYLINDRICAL:
        raise InputError(
            f"{source}: scan.arc_radius_mm needs a cylindrical detector; set scan.detector: cylindrical, or remove it"
        )
    if len(scan.get("flying_focal_spot", [])) > scan["views"]:
        raise InputError(f"{source}: scan.flying_focal_spot has more positions than scan.views; remove some")
    return OrbitGeometry(
        **{key: scan[key] for key in DETECTOR},
        angles_rad=math.radians(scan["start_angle_deg"]) + scan["direction"] * angles,
        source_z_mm=scan.get("start_z_mm", 0.0) + scan.get("table_feed_mm", 0.0) * turns,
        views_per_rotation=scan["views_per_rotation"],
        column_offset_px=scan.get("column_offset_px", 0.0),
        row_offset_px=scan.get("row_offset_px", 0.0),
        **detector_and_spot_fields(scan),
        view_interval_ms=interval,
        exposure_ms=exposure,
    )


def _angles(scan: dict, turns: np.ndarray, source: str) -> np.ndarray:
    """Return the angles from the first view, radians; in equal steps if they are unknown."""
    listed = scan.get("angles_deg", UNKNOWN)
    if listed == UNKNOWN:
        return 2 * np.pi * turns
    if len(listed) != scan["views"]:
        raise InputError(
            f"{source}: scan.angles_deg has {len(listed)} angles for {scan['views']} views; give one angle per view"
        )
    if scan["trajectory"] == "helical":
        raise InputError(f"{source}: scan.angles_deg has no meaning in a helical scan; remove it")
    return np.radians(listed)


def scale_note(scan: dict) -> str | None:
    """Return a note on what is not known of a scan: its length unit or its angles; None if both are known."""
    found = []
    if scan.get("length_unit") == ELEMENT:
        found.append(
            "lengths are in detector elements (scan.length_unit): effects that depend on a length in mm cannot be "
            "diagnosed, among them the spectrum; state the pixel size"
        )
    if scan.get("angles_deg") == UNKNOWN:
        found.append("the view angles are not known (scan.angles_deg): no model of the scan can be compared")
    return "; ".join(found) or None


def coverage_note(scan: dict, angles_rad: np.ndarray) -> str | None:
    """Return a note on views over less than half a turn; None if there are enough, or their angles are unknown."""
    steps = len(angles_rad) - 1
    if steps < 1 or scan.get("angles_deg") == UNKNOWN:
        return None
    covered = math.degrees(np.ptp(angles_rad)) * (1 + 1 / steps)  # each view counts for one step
    if covered >= HALF_TURN_DEG:
        return None
    return f"the views cover {covered:.3g} degrees, less than half a turn; check that the angles are in degrees"


def view_times(scan: dict, source: str) -> tuple[float | None, float | None]:
    """Return the time between views and the exposure time of a scan, ms; None if unknown.

    If only the exposure is stated, views are assumed to follow each other without a pause (`view_time_note`).

    Raises
    ------
    InputError
        For contradictory times.
    """
    interval, exposure = scan.get("view_interval_ms"), scan.get("exposure_ms")
    if "rotation_time_ms" in scan:
        expected = scan["rotation_time_ms"] / scan["views_per_rotation"]
        if interval is not None and abs(interval - expected) > TIME_TOLERANCE * expected:
            raise InputError(
                f"{source}: scan.view_interval_ms is {interval:g}, but rotation_time_ms / views_per_rotation is "
                f"{expected:g}; correct one of them"
            )
        interval = expected
    if interval is None:
        return exposure or None, exposure
    if exposure is not None and exposure > interval * (1 + TIME_TOLERANCE):
        raise InputError(
            f"{source}: scan.exposure_ms {exposure:g} is longer than the time between views, {interval:g} ms; correct "
            "one of them"
        )
    return interval, None if exposure is None else min(exposure, interval)


def has_view_times(content: dict) -> bool:
    """Return whether the time between views is known.

    Images are simulated with a protocol of the study, which states its times.
    """
    return content["kind"] != "projections" or view_times(content["scan"], "scan")[0] is not None


def view_time_note(scan: dict) -> str | None:
    """Return a note on what is assumed or missing about the scan's times; None if they are stated."""
    if {"rotation_time_ms", "view_interval_ms"} & scan.keys():
        return None
    if scan.get("exposure_ms"):
        return (
            f"the time between views is not stated; it is assumed to be the exposure, {scan['exposure_ms']:g} ms "
            "(scan.exposure_ms)"
        )
    return (
        "the time between views is not stated (scan.rotation_time_ms or scan.view_interval_ms): afterglow, motion and "
        "drift of the dark signal cannot be diagnosed"
    )


def check_lengths(scan: dict, source: str, size: bool = True) -> None:
    """Check that the lengths in a complete or incomplete scan section can all be in mm.

    Parameters
    ----------
    size : bool, optional
        Whether to check the size of the scanner: lengths in mm of a scanner of bodies or phantoms.

    Raises
    ------
    InputError
        If they cannot, or do not fit the beam.
    """
    advice = "check that all lengths are in mm"
    if scan.get("beam") == PARALLEL:
        for key in (*DISTANCES, "flying_focal_spot", "arc_radius_mm"):
            if key in scan:
                raise InputError(f"{source}: scan.{key} has no meaning in a parallel beam; remove it or scan.beam")
        if scan.get("detector", FLAT) != FLAT:
            raise InputError(f"{source}: scan.detector must be flat in a parallel beam; remove it or scan.beam")
    scan = with_beam(scan)
    if not {"source_to_isocentre_mm", "source_to_detector_mm"} <= scan.keys():
        return
    if size and scan.get("beam") != PARALLEL:
        limits = dict(zip(DISTANCES, DISTANCES_MM, strict=True))
        limits |= dict.fromkeys(("column_pitch_mm", "row_pitch_mm"), (SMALLEST_PITCH_MM, math.inf))
        for key, (low, high) in limits.items():
            value = scan.get(key, low)
            if not low <= value <= high:
                bound = f"less than the minimum of {low:g}" if value < low else f"more than the maximum of {high:g}"
                raise InputError(f"{source}: scan.{key}: {value:g} is {bound}; {advice} {IF_RIGHT}")
    isocentre, detector = scan["source_to_isocentre_mm"], scan["source_to_detector_mm"]
    if detector <= isocentre:
        raise InputError(
            f"{source}: scan.source_to_detector_mm {detector:g} is not larger than source_to_isocentre_mm "
            f"{isocentre:g}; if it is the distance from isocenter to detector, use {detector + isocentre:g}; {advice}"
        )
    if not {"columns", "column_pitch_mm"} <= scan.keys():
        return
    fan = _half_fan(scan)
    width = 2 * isocentre * math.sin(fan)
    if math.degrees(2 * fan) > LARGEST_FAN_DEG:
        raise InputError(
            f"{source}: scan: the fan angle of these lengths is {math.degrees(2 * fan):.0f} degrees (expected at most "
            f"{LARGEST_FAN_DEG:g}); {advice}"
        )
    low, high = FIELD_OF_VIEW_MM
    if size and scan.get("beam") != PARALLEL and not low <= width <= high:
        swapped = scan | {"columns": scan.get("rows", 1)}
        if scan["columns"] < swapped["columns"] and low <= 2 * isocentre * math.sin(_half_fan(swapped)) <= high:
            advice = f"check whether rows and columns are swapped, in {source} and in the data; {advice}"
        raise InputError(
            f"{source}: scan: the field of view of these lengths is {width:.3g} mm (expected {low:g} to {high:g} mm); "
            f"{advice} {IF_RIGHT}"
        )
    if scan.get("rows", 1) > 1 and "row_pitch_mm" in scan:
        aspect = scan["row_pitch_mm"] / scan["column_pitch_mm"]
        if max(aspect, 1 / aspect) > LARGEST_PIXEL_ASPECT:
            raise InputError(
                f"{source}: scan: pixels of {scan['column_pitch_mm']:g} x {scan['row_pitch_mm']:g} mm are implausible; "
                f"{advice}"
            )


def _half_fan(scan: dict) -> float:
    """Return half of the fan angle, radians."""
    half = scan["columns"] * scan["column_pitch_mm"] / 2
    detector = scan["source_to_detector_mm"]
    curved = scan.get("detector") == CYLINDRICAL
    return half / scan.get("arc_radius_mm", detector) if curved else math.atan(half / detector)
