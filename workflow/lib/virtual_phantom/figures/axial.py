"""Axial slices as a radiologist sees them: patient right on the image's left, anterior at the top.

Axes are in mm of the NIfTI world frame (+x to the patient's right, +y to anterior): x runs leftwards.
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
    """Few slices, found greedily, in which every ROI is cut at half of its largest cross-section or more.

    Of slices that show equally many ROIs, the one that cuts the largest shares of them; the first chosen shows most.

    Parameters
    ----------
    masks : mapping of str to ndarray, shape (z, y, x)
        By ROI, non-zero inside.

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
        shares = {name: one for name, one in shares.items() if one[best] < 0.5}
    return chosen


def body_mask(slice_hu: np.ndarray) -> np.ndarray:
    """The largest connected region over -500 HU of one slice, its holes filled.

    Parameters
    ----------
    slice_hu : ndarray, shape (y, x)

    Returns
    -------
    ndarray of bool, shape (y, x)

    Raises
    ------
    InputError
        If no pixel is over the threshold.
    """
    regions, count = ndimage.label(slice_hu > HU_BODY)
    if not count:
        raise InputError(f"phantom image: no voxel of the slice is over {HU_BODY:g} HU; is it in HU?")
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    return ndimage.binary_fill_holes(regions == largest)


def edges_mm(grid: Grid) -> tuple[float, float, float, float]:
    """Outer edges of the grid in the world frame, mm: x low, x high, y low, y high."""
    x, y = grid.centre_mm[:2]
    _, height, width = grid.extent_mm
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def slice_z_mm(grid: Grid, z: int) -> float:
    """World z of slice z, mm."""
    return grid.centre_mm[2] + float(grid.axes_mm()[0][z])


def body_box_mm(volume: Volume, slices: list[int], margin: float = 0.04) -> tuple[float, float, float, float]:
    """Box around the body in these slices, widened but not beyond the grid.

    Parameters
    ----------
    volume : Volume
        HU.
    margin : float, optional
        By how much it is wider on each side, as a share of the larger side of the body.

    Returns
    -------
    tuple of float
        x low, x high, y low, y high, mm in the world frame.

    Raises
    ------
    InputError
        If a slice has no pixel over -500 HU.
    """
    body = np.any([body_mask(volume.array[z]) for z in slices], axis=0)
    rows, columns = (np.flatnonzero(body.any(axis=axis)) for axis in (1, 0))
    x_low, x_high, y_low, y_high = edges_mm(volume.grid)
    _, dy, dx = volume.grid.spacing
    box = np.array(
        [
            x_low + columns[0] * dx,
            x_low + (columns[-1] + 1) * dx,
            y_low + rows[0] * dy,
            y_low + (rows[-1] + 1) * dy,
        ]
    )
    wider = margin * max(box[1] - box[0], box[3] - box[2])
    return (
        max(box[0] - wider, x_low),
        min(box[1] + wider, x_high),
        max(box[2] - wider, y_low),
        min(box[3] + wider, y_high),
    )


def show(
    axes: Axes,
    slice_array: np.ndarray,
    grid: Grid,
    box_mm: tuple[float, float, float, float],
    window: tuple[float, float] = WINDOW_HU,
    cmap: str = "gray",
) -> AxesImage:
    """Draw one slice to scale, with no ticks.

    Parameters
    ----------
    slice_array : ndarray, shape (y, x)
    box_mm : tuple of float
        What is shown of it, mm, as body_box_mm gives it.
    window : tuple of float, optional
        Values at both ends of the colours.
    """
    image = axes.imshow(slice_array, cmap=cmap, vmin=window[0], vmax=window[1], origin="lower", extent=edges_mm(grid))
    axes.set(xlim=(box_mm[1], box_mm[0]), ylim=(box_mm[2], box_mm[3]), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    return image


def mark_sides(axes: Axes) -> None:
    """Write R and L where the patient's right and left are."""
    for x, side, align in ((0.02, "R", "left"), (0.98, "L", "right")):
        axes.text(x, 0.98, side, transform=axes.transAxes, ha=align, va="top", color="white", path_effects=OUTLINED)


def scale_bar(axes: Axes) -> None:
    """Draw a bar of a round length in mm, near a quarter of the width, at the lower left."""
    left, right = axes.get_xlim()
    low, high = axes.get_ylim()
    quarter = abs(right - left) / 4
    power = 10 ** np.floor(np.log10(quarter))
    length = power * max(step for step in (1, 2, 5) if step * power <= quarter)
    start, direction = left + 0.03 * (right - left), np.sign(right - left)
    y = low + 0.05 * (high - low)
    axes.plot(
        [start, start + direction * length],
        [y, y],
        color="white",
        linewidth=2,
        solid_capstyle="butt",
        path_effects=[patheffects.withStroke(linewidth=3, foreground="black")],
    )
    axes.text(
        start + direction * length / 2,
        y + 0.015 * (high - low),
        f"{length:g} mm",
        color="white",
        ha="center",
        va="bottom",
        path_effects=OUTLINED,
    )
