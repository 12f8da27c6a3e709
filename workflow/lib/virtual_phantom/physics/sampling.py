"""Where rays begin and end: points of the focal spot, and points of a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.geometry import ScanGeometry, orbit_of


def quadrature(samples: int, of_rows: bool = True) -> list[tuple[tuple[float, float], float]]:
    """Where rays meet a pixel: Gauss and Legendre's nodes, so that two per direction blur as the whole pixel does.

    Rays evenly spaced would blur by 1 - 1 / samples^2 of that.

    Parameters
    ----------
    samples : int
        Rays per direction.
    of_rows : bool, optional
        False for a detector of one row (fan beam), whose rays stay in the plane.

    Returns
    -------
    list of tuple
        ((column, row) from the pixel's centre in pixels, weight).
    """
    nodes, weights = np.polynomial.legendre.leggauss(samples)
    columns = [(float(node) / 2, float(weight) / 2) for node, weight in zip(nodes, weights, strict=True)]
    rows = columns if of_rows else [(0.0, 1.0)]
    return [((column, row), one * other) for row, other in rows for column, one in columns]


def displaced(geometry: ScanGeometry, column_mm: float, row_mm: float, away_mm: float = 0.0) -> ScanGeometry:
    """The geometry of a point of the focal spot beside its centre.

    A source moved by s along the column axis stands where a gantry turned by -s/R would put it; the detector, which
    stays, then lies s (D - R)/R off in the turned frame. Its tilt against that frame (s/R) is neglected.

    Parameters
    ----------
    geometry : ScanGeometry
    column_mm, row_mm : float
        Along the detector's columns and rows.
    away_mm : float, optional
        Along the central ray, away from the isocentre.

    Returns
    -------
    ScanGeometry

    Raises
    ------
    InputError
        If the point is displaced and the scan is no circle or helix.
    """
    if not column_mm and not row_mm and not away_mm:
        return geometry
    geometry = orbit_of(geometry, "focal_spot")
    radius, distance = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
    turn = -column_mm / radius
    return replace(
        geometry,
        angles_rad=geometry.angles_rad + turn,
        column_offset_px=geometry.column_offset_px - turn * (distance - radius) / geometry.column_pitch_mm,
        source_z_mm=geometry.source_z_mm + row_mm,
        source_to_isocentre_mm=radius + away_mm,
        source_to_detector_mm=distance + away_mm,
        row_offset_px=geometry.row_offset_px - row_mm / geometry.row_pitch_mm,
    )
