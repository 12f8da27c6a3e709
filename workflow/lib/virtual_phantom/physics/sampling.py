"""Where rays begin and end: points of the focal spot, and points of a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.geometry import ScanGeometry


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
    """The geometry of a point of the focal spot beside its centre: the source moves, the detector stays.

    Parameters
    ----------
    geometry : ScanGeometry
    column_mm, row_mm : float
        Displacement along the detector's columns and rows, mm.
    away_mm : float, optional
        Displacement across the detector, away from it, mm.

    Returns
    -------
    ScanGeometry
    """
    if not column_mm and not row_mm and not away_mm:
        return geometry
    vectors = geometry.by_vectors()
    by_mm = column_mm * vectors.column_direction + row_mm * vectors.row_direction - away_mm * vectors.normal
    return replace(vectors, source_mm=vectors.source_mm + by_mm)
