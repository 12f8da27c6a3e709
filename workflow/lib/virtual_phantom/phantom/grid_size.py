"""Advice on the size of a grid that is too small for the body, in the order z, y, x of the configuration."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..base.geometry import Grid

ROUNDING = 1e-6  # tolerance, in voxels


def minimum_shape(grid: Grid, needed_mm: Sequence[float]) -> list[int]:
    """Return the smallest shape that spans lengths (z, y, x), mm, and is nowhere smaller than the grid's shape."""
    return [
        max(n, math.ceil(length / wide - ROUNDING))
        for n, wide, length in zip(grid.shape, grid.spacing, needed_mm, strict=True)
    ]


def suggest_size(grid: Grid, needed_mm: Sequence[float], object_mm: Sequence[float] | None = None) -> str:
    """Suggest settings with which the grid spans the lengths needed (z, y, x), mm.

    If the grid fits with an entry in reverse order, and is then closer to the object size than with more voxels, the
    order is reported as wrong. Otherwise the needed shape is suggested.

    Parameters
    ----------
    object_mm : sequence of 3 float, optional
        Size of the object (z, y, x), mm, if larger than needed.
    """
    shape, spacing = list(grid.shape), list(grid.spacing)
    reversals = {}
    for keys, reverse in (
        (("grid.shape",), Grid(shape[::-1], spacing)),
        (("grid.spacing_mm",), Grid(shape, spacing[::-1])),
        (("grid.shape", "grid.spacing_mm"), Grid(shape[::-1], spacing[::-1])),
    ):
        fits = all(has >= length - ROUNDING for has, length in zip(reverse.extent_mm, needed_mm, strict=True))
        if fits and reverse != Grid(shape, spacing):
            reversals[keys] = reverse
    enough = minimum_shape(grid, needed_mm)
    if reversals:
        target = object_mm or needed_mm

        def misfit(candidate: Grid) -> float:
            return sum(abs(math.log(has / length)) for has, length in zip(candidate.extent_mm, target, strict=True))

        keys = min(reversals, key=lambda keys: misfit(reversals[keys]))
        # With nearly cubic voxels, a body that is slightly too wide may fit the reversed grid by chance.
        if misfit(Grid(enough, spacing)) > misfit(reversals[keys]):
            values = {"grid.shape": shape, "grid.spacing_mm": spacing}
            return " and ".join(
                f"{key} {values[key]} looks like x, y, z; write z, y, x: {values[key][::-1]}" for key in keys
            )
    return f"set grid.shape to at least {enough} (z, y, x) at this grid.spacing_mm"
