"""Recording with outlines of the aligned phantom, and the difference between both."""

from collections.abc import Mapping, Sequence

import numpy as np
import SimpleITK as sitk
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_BODY
from ..io.simpleitk import itk_image, itk_resample
from ..io.volumes import Volume
from . import axial, style
from .scans import round_up

BODY_COLOR = "#FFFFFF"
UNKNOWN = "#BBBBBB"  # outside of the phantom's image


@style.styled()
def draw(
    image: Volume,
    phantom: Volume,
    matrix: Sequence[Sequence[float]],
    masks: Mapping[str, np.ndarray],
    tissue_class: Mapping[str, str],
) -> Figure:
    """Draw an axial and a coronal slice of the recording with outlines, and of the recording minus the phantom.

    The slices are those that show most ROIs. For the difference, the phantom is interpolated on the recording's grid.
    The window is the next round number above the 98th percentile of the absolute differences inside the body.

    Parameters
    ----------
    image, phantom : Volume
        HU, each on its own grid.
    matrix : sequence of sequence of float, shape (4, 4)
        Phantom world mm to recording world mm.
    masks : mapping of str to ndarray, shape (z, y, x)
        ROIs on the recording's grid, non-zero inside.
    tissue_class : mapping of str to str
        {ROI: class}.

    Raises
    ------
    InputError
        If there is no ROI, an ROI is empty, or image and phantom do not overlap.
    """
    back = np.linalg.inv(matrix)
    to_phantom = sitk.AffineTransform(back[:3, :3].ravel().tolist(), back[:3, 3].tolist())
    aligned = itk_resample(itk_image(phantom.array, phantom.grid), image.grid, to_phantom, float("nan"))
    if not (aligned > HU_BODY).any():
        raise InputError("figure of the alignment: the phantom lies outside the recording; align it again")
    z = axial.choose_slices(masks)[0]
    y = axial.choose_slices({name: np.moveaxis(mask, 1, 0) for name, mask in masks.items()})[0]
    colors = style.assign((tissue_class[roi] for roi in masks), style.ON_GRAY_IMAGE)
    box = _box_mm(aligned, image.grid)

    x_mm, y_mm, z_mm = (box[2 * k + 1] - box[2 * k] for k in range(3))
    panel_mm = (style.DOUBLE_COLUMN_MM - 2 * 16) / 2
    heights = [panel_mm * y_mm / x_mm, panel_mm * z_mm / x_mm]
    figure = style.figure(style.DOUBLE_COLUMN_MM, sum(heights) + 2 * 9 + 10)
    panels = figure.subplots(2, 2, gridspec_kw={"height_ratios": heights})
    views = [
        (lambda array: array[z], (0, 1), f"z = {axial.slice_z_mm(image.grid, z):.1f} mm"),
        (
            lambda array: array[:, y],
            (0, 2),
            f"y = {image.grid.centre_mm[1] + float(image.grid.axes_mm()[1][y]):.1f} mm",
        ),
    ]
    body = np.concatenate([(cut(image.array) - cut(aligned))[cut(aligned) > HU_BODY] for cut, _, _ in views])
    limit = round_up(float(np.percentile(np.abs(body), 98)))
    for row, (cut, plane, title) in enumerate(views):
        left, right = panels[row]
        extent = axial.edges_mm(image.grid, plane)
        visible = tuple(end for k in plane for end in box[2 * k : 2 * k + 2])
        shown = axial.show(left, cut(image.array), image.grid, visible, plane=plane)
        remaining = cut(image.array) - cut(aligned)
        difference = axial.show(right, remaining, image.grid, visible, (-limit, limit), "RdBu_r", plane)
        right.set_facecolor(UNKNOWN)
        _outline(left, np.nan_to_num(cut(aligned), nan=-1000.0), extent, HU_BODY, BODY_COLOR, 0.7)
        for roi, mask in masks.items():
            if cut(mask).any():
                _outline(left, (cut(mask) != 0).astype(float), extent, 0.5, colors[tissue_class[roi]], 1.1)
        for axes in (left, right):
            axial.mark_sides(axes)
        left.set_title(f"recording, {title}".replace("-", "−"))
        right.set_title("recording − phantom")
        axial.scale_bar(left) if row == 0 else None
    for index, axes in enumerate(panels.ravel()):
        style.letter_panel(axes, index)
    figure.colorbar(shown, ax=panels[:, 0].tolist(), label="CT number (HU)", pad=0.02, aspect=30)
    figure.colorbar(difference, ax=panels[:, 1].tolist(), label="difference (HU)", pad=0.02, aspect=30)
    handles = [Line2D([], [], color=BODY_COLOR, label="phantom surface", path_effects=axial.OUTLINED)]
    handles += [Line2D([], [], color=color, label=style.label(name)) for name, color in colors.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 6))
    return figure


def _box_mm(aligned: np.ndarray, grid: Grid) -> tuple[float, ...]:
    """Return the box with a margin around the body of a phantom: x low, x high, y low, ..., z high, world mm."""
    voxels = np.argwhere(np.nan_to_num(aligned, nan=-1000.0) > HU_BODY)[:, ::-1]
    low = voxels.min(axis=0) * grid.spacing[::-1] + grid.affine[:3, 3]
    high = voxels.max(axis=0) * grid.spacing[::-1] + grid.affine[:3, 3]
    wider = 0.06 * (high - low).max()
    half = np.array(grid.extent_mm[::-1]) / 2
    low, high = np.maximum(low - wider, grid.centre_mm - half), np.minimum(high + wider, grid.centre_mm + half)
    return tuple(np.column_stack([low, high]).ravel())


def _outline(axes: Axes, array: np.ndarray, extent, level: float, color: str, width: float) -> None:
    rows, columns = array.shape
    dx, dy = (extent[1] - extent[0]) / columns, (extent[3] - extent[2]) / rows
    x, y = extent[0] + (np.arange(columns) + 0.5) * dx, extent[2] + (np.arange(rows) + 0.5) * dy
    if min(rows, columns) > 1:
        axes.contour(x, y, array, levels=[level], colors=[color], linewidths=width, linestyles="solid")
