"""Check that the scans of a configuration cover the body and every ROI, and compute missing columns and rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid, grid_of, scan_geometry
from ...base.settings import ScanSettings
from ...config.settings import Study
from .coverage import columns_for, points_of, rows_for, worst_share


def world_grid(study: Study, centre_mm=(0.0, 0.0, 0.0)) -> Grid:
    """Return the grid of the study in NIfTI world coordinates."""
    return replace(grid_of(study.grid), centre_mm=tuple(centre_mm))


def blind_spots(
    study: Study, grid: Grid, reach_mm: float, masks: Mapping[str, np.ndarray], slack_mm: float = 0.0
) -> Iterator[str]:
    """Yield a line for each scan that does not cover the body or an ROI.

    Parameters
    ----------
    study : Study
        Sections that the schema refuses are None.
    reach_mm : float
        Largest distance of the body from the axis of rotation.
    masks : mapping of str to ndarray of bool
        ROIs on the grid.
    slack_mm : float, optional
        Tolerance of `reach_mm`, which is measured on other voxels than the scanned ones.
    """
    points = points_of(grid, masks)
    for where, scan, views in _scans(study):
        radius = scan_geometry(scan, max(views), grid).field_of_view_radius_mm
        wide = scan
        if reach_mm - slack_mm > radius:
            columns = columns_for(reach_mm, scan)
            yield _too_narrow(where, scan, reach_mm, radius, columns)
            if columns is None:
                continue
            wide = replace(scan, columns=max(columns, scan.columns))
        yield from _unseen(where, wide, views, grid, points)


def _scans(study: Study) -> Iterator[tuple[str, ScanSettings, list[int]]]:
    """Yield (key, scan, numbers of projections) for each scan that a protocol uses."""
    protocols = (study.protocols or {}).values()
    scans = {None: ("scan", study.scan)} | {name: (f"scans.{name}", scan) for name, scan in study.scans.items()}
    for name, (where, scan) in scans.items():
        views = sorted({protocol.projections for protocol in protocols if protocol.scan == name})
        if scan is not None and views and scan.source_to_detector_mm > scan.source_to_isocentre_mm:
            yield where, scan, views


def _too_narrow(where: str, scan: ScanSettings, reach_mm: float, radius_mm: float, columns: int | None) -> str:
    missing = reach_mm - radius_mm
    message = (
        f"{where}: the phantom reaches {reach_mm:.0f} mm from the isocenter, the field of view only {radius_mm:.0f} "
        f"mm: {missing:.0f} mm are missing"
    )
    if columns is None:
        return f"{message}; move the center of the phantom, or increase {where}.source_to_isocentre_mm"
    pitch = math.ceil(10 * scan.column_pitch_mm * columns / scan.columns) / 10
    return (
        f"{message}; set {where}.columns to at least {columns} (now {scan.columns}), or {where}.column_pitch_mm to "
        f"at least {pitch:g}, or move the center of the phantom"
    )


def _unseen(
    where: str, scan: ScanSettings, views: list[int], grid: Grid, points: Mapping[str, np.ndarray]
) -> Iterator[str]:
    """Yield a line that names all ROIs that some protocol does not see from every direction."""
    if not points:
        return
    worst, hidden, worst_views = 1.0, {}, views[0]
    for projections in views:
        try:
            shares = {name: worst_share(scan, projections, grid, of_roi) for name, of_roi in points.items()}
        except InputError as error:
            yield str(error).replace("scan:", f"{where}:", 1)
            return
        for name, share in shares.items():
            if share < 1:
                hidden[name] = None
                if share < worst:
                    worst, worst_views = share, projections
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
        advice = "use a smaller pitch, more turns, or more projections"
    else:
        missing = max(rows) - scan.rows
        advice = (
            f"{missing} rows are missing: set {where}.rows to at least {max(rows)} (now {scan.rows}), or use a "
            "smaller pitch or more turns"
        )
    yield (
        f"{where}: {names} not seen from every direction: in the worst case from {100 * worst:.0f} % of half a "
        f"turn, with {worst_views} projections; {advice}"
    )
