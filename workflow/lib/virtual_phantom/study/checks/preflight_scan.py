"""Whether the scans of a configuration see the whole body and every ROI; if not, what is missing, in numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid, grid_of, scan_geometry
from .coverage import columns_for, points_of, rows_for, worst_share


def grid_here(config: Mapping, centre_mm=(0.0, 0.0, 0.0)) -> Grid:
    """The study's grid, at its place in the world."""
    return replace(grid_of(config["grid"]), centre_mm=tuple(centre_mm))


def blind_spots(
    config: Mapping, grid: Grid, reach_mm: float, masks: Mapping[str, np.ndarray], slack_mm: float = 0.0
) -> Iterator[str]:
    """What the scans of a configuration do not see, a line for each scan that it has.

    Parameters
    ----------
    config : mapping
        With the schema's defaults; sections may be missing.
    reach_mm : float
        How far the body reaches from the isocentre's axis.
    masks : mapping of str to ndarray of bool
        ROIs on the grid.
    slack_mm : float, optional
        How much of the reach may be due to its being taken on other voxels than those that are scanned.
    """
    points = points_of(grid, masks)
    for where, scan, views in _scans(config):
        radius = scan_geometry(scan, max(views), grid).field_of_view_radius_mm
        wide = dict(scan)
        if reach_mm - slack_mm > radius:
            columns = columns_for(reach_mm, scan)
            yield _too_narrow(where, scan, reach_mm, radius, columns)
            if columns is None:
                continue
            wide["columns"] = max(columns, scan["columns"])
        yield from _unseen(where, wide, views, grid, points)


def _scans(config: Mapping) -> Iterator[tuple[str, dict, list[int]]]:
    """(its key, the scan, numbers of projections that protocols take with it) of scans that are used."""
    protocols = config.get("protocols", {}).values()
    scans = {None: ("scan", config.get("scan"))} | {
        name: (f"scans.{name}", scan) for name, scan in config.get("scans", {}).items()
    }
    for name, (where, scan) in scans.items():
        views = sorted({one["projections"] for one in protocols if one.get("scan") == name})
        if scan is not None and views and scan["source_to_detector_mm"] > scan["source_to_isocentre_mm"]:
            yield where, scan, views


def _too_narrow(where: str, scan: Mapping, reach_mm: float, radius_mm: float, columns: int | None) -> str:
    missing = reach_mm - radius_mm
    message = (
        f"{where}: the phantom reaches {reach_mm:.0f} mm from the isocentre, the field of view only {radius_mm:.0f} "
        f"mm: {missing:.0f} mm are missing"
    )
    if columns is None:
        return f"{message}; move the phantom's centre, or set {where}.source_to_isocentre_mm to much more"
    pitch = math.ceil(10 * scan["column_pitch_mm"] * columns / scan["columns"]) / 10
    return (
        f"{message}; set {where}.columns to at least {columns} (now {scan['columns']}), or {where}.column_pitch_mm to "
        f"at least {pitch:g}, or move the phantom's centre"
    )


def _unseen(where: str, scan: Mapping, views: list[int], grid: Grid, points: Mapping[str, np.ndarray]) -> Iterator[str]:
    """A line for all ROIs that some of the protocols do not see from every direction."""
    if not points:
        return
    worst, hidden, of_views = 1.0, {}, views[0]
    for projections in views:
        try:
            shares = {name: worst_share(scan, projections, grid, place) for name, place in points.items()}
        except InputError as error:
            yield str(error).replace("scan:", f"{where}:", 1)
            return
        for name, share in shares.items():
            if share < 1:
                hidden[name] = None
                if share < worst:
                    worst, of_views = share, projections
    if not hidden:
        return
    together = np.concatenate([points[name] for name in hidden])
    rows = [
        rows_for(scan, projections, grid, together)
        for projections in views
        if worst_share(scan, projections, grid, together) < 1
    ]
    names = f"ROI {next(iter(hidden))} is" if len(hidden) == 1 else f"ROIs {', '.join(hidden)} are"
    if None in rows:
        advice = "give a smaller pitch, more turns, or the protocols more projections"
    else:
        missing = max(rows) - scan["rows"]
        advice = (
            f"{missing} rows are missing: set {where}.rows to at least {max(rows)} (now {scan['rows']}), or a smaller "
            "pitch, or more turns"
        )
    yield (
        f"{where}: {names} not seen from every direction: {100 * worst:.0f} % of half a turn where it is worst, in "
        f"{of_views} projections; {advice}"
    )
