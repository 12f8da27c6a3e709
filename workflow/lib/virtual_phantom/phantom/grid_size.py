"""What a grid must be to hold a body, said in the order in which the configuration wants it: z, y, x."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..base.geometry import Grid

ROUNDING = 1e-6  # of a voxel


def minimum_shape(grid: Grid, needed_mm: Sequence[float]) -> list[int]:
    """The fewest voxels (z, y, x) of this size that span lengths (z, y, x), mm; never fewer than there are."""
    return [
        max(n, math.ceil(length / wide - ROUNDING))
        for n, wide, length in zip(grid.shape, grid.spacing, needed_mm, strict=True)
    ]


def suggest_size(grid: Grid, needed_mm: Sequence[float], object_mm: Sequence[float] | None = None) -> str:
    """What to set so that the grid spans some lengths.

    Parameters
    ----------
    grid : Grid
        That does not.
    needed_mm : sequence of 3 float
        Lengths (z, y, x), mm.
    object_mm : sequence of 3 float, optional
        How large the object is, mm (z, y, x), where it may be longer than what is needed.

    Returns
    -------
    str
        That the order of an entry is wrong, if the other way round it would do, and lie nearer to the object than with
        the voxels that are missing; else the shape that is needed.
    """
    shape, spacing = list(grid.shape), list(grid.spacing)
    right = {}
    for keys, turned in (
        (("grid.shape",), Grid(shape[::-1], spacing)),
        (("grid.spacing_mm",), Grid(shape, spacing[::-1])),
        (("grid.shape", "grid.spacing_mm"), Grid(shape[::-1], spacing[::-1])),
    ):
        fits = all(has >= length - ROUNDING for has, length in zip(turned.extent_mm, needed_mm, strict=True))
        if fits and turned != Grid(shape, spacing):
            right[keys] = turned
    enough = minimum_shape(grid, needed_mm)
    if right:
        target = object_mm or needed_mm

        def off(one: Grid) -> float:
            return sum(abs(math.log(has / of)) for has, of in zip(one.extent_mm, target, strict=True))

        keys = min(right, key=lambda keys: off(right[keys]))
        # A body a little too wide fits by chance if voxels of nearly one size are turned.
        if off(Grid(enough, spacing)) <= off(right[keys]):
            right = {}
    if right:
        said = {"grid.shape": (shape, shape[::-1]), "grid.spacing_mm": (spacing, spacing[::-1])}
        return " and ".join(f"{key} {said[key][0]} looks like x, y, z; write z, y, x: {said[key][1]}" for key in keys)
    return f"set grid.shape to at least {enough} (z, y, x) at this grid.spacing_mm"
