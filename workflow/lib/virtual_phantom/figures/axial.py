"""Axial slices in radiological orientation: the patient's right on the left, anterior at the top.

Axes are in mm of the NIfTI world frame (+x to the patient's right, +y to anterior), so x increases to the left.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from scipy import ndimage

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_BODY
from ..io.volumes import Volume

WINDOW_HU = (40 - 400 / 2, 40 + 400 / 2)  # the usual abdominal window: level 40, width 400
OUTLINED = [patheffects.withStroke(linewidth=2, foreground="black")]


def choose_slices(masks: Mapping[str, np.ndarray]) -> list[int]:
    """Choose few slices that show every ROI with at least half of its largest cross-section (greedy search).

    Slices that show most ROIs come first; among slices with equally many, the one with the largest cross-sections.

    Parameters
    ----------
    masks : mapping of str to ndarray, shape (z, y, x)
        ROIs, non-zero inside.

    Raises
    ------
    InputError
        If there is no ROI, or an empty one.
    """
    if not masks:
        raise InputError("ROIs: there are none to draw; check phantom/rois.csv")
    shares = {}
    for name, mask in masks.items():
        area = np.count_nonzero(mask, axis=(1, 2))
        if not area.any():
            raise InputError(f"ROI {name}: its mask is empty; draw it again")
        shares[name] = area / area.max()
    chosen = []
    while shares:
        share = np.stack(list(shares.values()))
        shown = share >= 0.5
        best = int(np.argmax(shown.sum(axis=0) + np.where(shown, share, 0).sum(axis=0) / (len(share) + 1)))
        chosen.append(best)
        shares = {name: share for name, share in shares.items() if share[best] < 0.5}
    return chosen


def body_mask(slice_hu: np.ndarray) -> np.ndarray:
    """Return the largest connected part of a slice (y, x) above -500 HU, with holes filled; InputError if none."""
    regions, count = ndimage.label(slice_hu > HU_BODY)
    if not count:
        raise InputError(f"phantom image: no voxel of the slice is above {HU_BODY:g} HU; check that the image is in HU")
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    return ndimage.binary_fill_holes(regions == largest)


def edges_mm(grid: Grid, plane: tuple[int, int] = (0, 1)) -> tuple[float, float, float, float]:
    """Return outer edges of the grid along two axes, by default x and y, world mm: x low, x high, y low, y high."""
    (x, width), (y, height) = ((grid.centre_mm[axis], grid.extent_mm[::-1][axis]) for axis in plane)
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def slice_z_mm(grid: Grid, z: int) -> float:
    """Return the world z of slice z, mm."""
    return grid.centre_mm[2] + float(grid.axes_mm()[0][z])


def body_box_mm(volume: Volume, slices: list[int]) -> tuple[float, float, float, float]:
    """Return the box around the body in these slices, within the grid: x low, x high, y low, y high, world mm.

    Parameters
    ----------
    volume : Volume
        HU.
    """
    body = np.any([body_mask(volume.array[z]) for z in slices], axis=0)
    rows, columns = (np.flatnonzero(body.any(axis=axis)) for axis in (1, 0))
    x_low, x_high, y_low, y_high = edges_mm(volume.grid)
    _, dy, dx = volume.grid.spacing
    left, right = x_low + columns[0] * dx, x_low + (columns[-1] + 1) * dx
    bottom, top = y_low + rows[0] * dy, y_low + (rows[-1] + 1) * dy
    wider = 0.04 * max(right - left, top - bottom)
    return max(left - wider, x_low), min(right + wider, x_high), max(bottom - wider, y_low), min(top + wider, y_high)


def show(
    axes: Axes,
    slice_array: np.ndarray,
    grid: Grid,
    box_mm: tuple[float, float, float, float],
    window: tuple[float, float] = WINDOW_HU,
    cmap: str = "gray",
    plane: tuple[int, int] = (0, 1),
) -> AxesImage:
    """Draw a slice (y, x) to scale, without ticks; `box_mm` is the visible part, as from `body_box_mm`."""
    extent = edges_mm(grid, plane)
    image = axes.imshow(slice_array, cmap=cmap, vmin=window[0], vmax=window[1], origin="lower", extent=extent)
    axes.set(xlim=(box_mm[1], box_mm[0]), ylim=(box_mm[2], box_mm[3]), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    return image


def mark_sides(axes: Axes) -> None:
    """Write R and L where the patient's right and left are."""
    for x, side, align in ((0.02, "R", "left"), (0.98, "L", "right")):
        axes.text(x, 0.98, side, transform=axes.transAxes, ha=align, va="top", color="white", path_effects=OUTLINED)


def scale_bar(axes: Axes) -> None:
    """Draw a scale bar at the lower left, with a round length in mm of at most a quarter of the width."""
    left, right = axes.get_xlim()
    low, high = axes.get_ylim()
    quarter = abs(right - left) / 4
    power = 10 ** np.floor(np.log10(quarter))
    length = power * max(step for step in (1, 2, 5) if step * power <= quarter)
    start, direction = left + 0.03 * (right - left), np.sign(right - left)
    y = low + 0.05 * (high - low)
    ends, halo = [start, start + direction * length], [patheffects.withStroke(linewidth=3, foreground="black")]
    axes.plot(ends, [y, y], color="white", linewidth=2, solid_capstyle="butt", path_effects=halo)
    middle, above = start + direction * length / 2, y + 0.015 * (high - low)
    axes.text(middle, above, f"{length:g} mm", color="white", ha="center", va="bottom", path_effects=OUTLINED)
