"""A recording with the phantom's outlines where the alignment puts them, and what is left between the two."""

from collections.abc import Mapping, Sequence

import numpy as np
import SimpleITK as sitk
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_BODY
from ..io.volumes import Volume
from . import axial, style
from .scans import round_up

BODY_COLOUR = "#FFFFFF"
UNKNOWN = "#BBBBBB"  # where there is no phantom to subtract


@style.styled()
def draw(
    image: Volume,
    phantom: Volume,
    matrix: Sequence[Sequence[float]],
    masks: Mapping[str, np.ndarray],
    tissue_class: Mapping[str, str],
) -> Figure:
    """An axial and a coronal slice of the recording with outlines, and beside each the recording minus the phantom.

    The slices are those that show most ROIs. For the difference the phantom is interpolated onto the recording's grid;
    its window is the next round number over the 98th percentile of the magnitudes inside the phantom's body.

    Parameters
    ----------
    image, phantom : Volume
        HU, each on its own grid.
    matrix : sequence of sequence of float, shape (4, 4)
        Phantom world mm to recording world mm.
    masks : mapping of str to ndarray, shape (z, y, x)
        By ROI, on the recording's grid, non-zero inside.
    tissue_class : mapping of str to str
        By ROI.

    Raises
    ------
    InputError
        If there is no ROI or an empty one, or if image and phantom do not overlap.
    """
    carried = _carry(phantom, np.array(matrix), image.grid)
    if not (carried > HU_BODY).any():
        raise InputError("figure of the alignment: the phantom lies outside the recording; align it again")
    z = axial.choose_slices(masks)[0]
    y = axial.choose_slices({name: np.moveaxis(mask, 1, 0) for name, mask in masks.items()})[0]
    colours = style.assign((tissue_class[roi] for roi in masks), style.ON_GREY_IMAGE)
    box = _box_mm(carried, image.grid)

    x_mm, y_mm, z_mm = (box[2 * k + 1] - box[2 * k] for k in range(3))
    panel_mm = (style.DOUBLE_COLUMN_MM - 2 * 16) / 2
    heights = [panel_mm * y_mm / x_mm, panel_mm * z_mm / x_mm]
    figure = style.figure(style.DOUBLE_COLUMN_MM, sum(heights) + 2 * 9 + 10)
    panels = figure.subplots(2, 2, gridspec_kw={"height_ratios": heights})
    views = [
        (lambda array: array[z], (0, 1), f"z = {axial.slice_z_mm(image.grid, z):.1f} mm"),
        (lambda array: array[:, y], (0, 2), f"y = {_row_y_mm(image.grid, y):.1f} mm"),
    ]
    limit = round_up(
        _spread([cut(image.array) - cut(carried) for cut, _, _ in views], [cut(carried) for cut, _, _ in views])
    )
    for row, (cut, axes_of_view, title) in enumerate(views):
        left, right = panels[row]
        extent, limits = _extent(image.grid, axes_of_view), [box[2 * k : 2 * k + 2] for k in axes_of_view]
        shown = _show(left, cut(image.array), extent, limits, axial.WINDOW_HU, "gray")
        shade = _show(right, cut(image.array) - cut(carried), extent, limits, (-limit, limit), "RdBu_r")
        right.set_facecolor(UNKNOWN)
        _outline(left, np.nan_to_num(cut(carried), nan=-1000.0), extent, HU_BODY, BODY_COLOUR, 0.7)
        for roi, mask in masks.items():
            if cut(mask).any():
                _outline(left, (cut(mask) != 0).astype(float), extent, 0.5, colours[tissue_class[roi]], 1.1)
        for axes in (left, right):
            axial.mark_sides(axes)
        left.set_title(f"recording, {title}".replace("-", "−"))
        right.set_title("recording − phantom")
        axial.scale_bar(left) if row == 0 else None
    for index, axes in enumerate(panels.ravel()):
        style.letter_panel(axes, index)
    figure.colorbar(shown, ax=panels[:, 0].tolist(), label="CT number (HU)", pad=0.02, aspect=30)
    figure.colorbar(shade, ax=panels[:, 1].tolist(), label="difference (HU)", pad=0.02, aspect=30)
    handles = [Line2D([], [], color=BODY_COLOUR, label="phantom's surfaces", path_effects=axial.OUTLINED)]
    handles += [Line2D([], [], color=colour, label=style.label(name)) for name, colour in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 6))
    return figure


def _carry(phantom: Volume, matrix: np.ndarray, grid: Grid) -> np.ndarray:
    """The phantom (HU) interpolated on the recording's grid; NaN where there is none."""
    image = sitk.GetImageFromArray(phantom.array)
    image.SetSpacing(phantom.grid.spacing[::-1])
    image.SetOrigin(tuple(phantom.grid.affine[:3, 3]))
    back = np.linalg.inv(matrix)
    transform = sitk.AffineTransform(back[:3, :3].ravel().tolist(), back[:3, 3].tolist())
    upright = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    placed = (tuple(grid.affine[:3, 3]), grid.spacing[::-1], upright, float("nan"), sitk.sitkFloat32)
    return sitk.GetArrayFromImage(sitk.Resample(image, grid.shape[::-1], transform, sitk.sitkLinear, *placed))


def _box_mm(carried: np.ndarray, grid: Grid, margin: float = 0.06) -> tuple[float, ...]:
    """Box around the carried body, widened: x low, x high, y low, y high, z low, z high, world mm."""
    places = np.argwhere(np.nan_to_num(carried, nan=-1000.0) > HU_BODY)[:, ::-1]
    low = places.min(axis=0) * grid.spacing[::-1] + grid.affine[:3, 3]
    high = places.max(axis=0) * grid.spacing[::-1] + grid.affine[:3, 3]
    wider = margin * (high - low).max()
    half = np.array(grid.extent_mm[::-1]) / 2
    low, high = np.maximum(low - wider, grid.centre_mm - half), np.minimum(high + wider, grid.centre_mm + half)
    return tuple(np.column_stack([low, high]).ravel())


def _extent(grid: Grid, axes: tuple[int, int]) -> tuple[float, ...]:
    extent, centre = grid.extent_mm[::-1], grid.centre_mm
    return tuple(centre[k] + side * extent[k] / 2 for k in axes for side in (-1, 1))


def _row_y_mm(grid: Grid, y: int) -> float:
    return grid.centre_mm[1] + float(grid.axes_mm()[1][y])


def _show(axes: Axes, array: np.ndarray, extent, limits, window, cmap: str):
    shown = axes.imshow(array, cmap=cmap, vmin=window[0], vmax=window[1], origin="lower", extent=extent)
    axes.set(xlim=limits[0][::-1], ylim=limits[1], aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    return shown


def _outline(axes: Axes, array: np.ndarray, extent, level: float, colour: str, width: float) -> None:
    rows, columns = array.shape
    dx, dy = (extent[1] - extent[0]) / columns, (extent[3] - extent[2]) / rows
    x, y = extent[0] + (np.arange(columns) + 0.5) * dx, extent[2] + (np.arange(rows) + 0.5) * dy
    if min(rows, columns) > 1:
        axes.contour(x, y, array, levels=[level], colors=[colour], linewidths=width, linestyles="solid")


def _spread(differences: list[np.ndarray], carried: list[np.ndarray]) -> float:
    inside = [d[c > HU_BODY] for d, c in zip(differences, carried, strict=True)]
    return float(np.percentile(np.abs(np.concatenate(inside)), 98))
