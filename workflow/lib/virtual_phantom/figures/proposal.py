"""Slices of a CT with the regions that become ROIs, the unused regions, and the scanned box."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ..io.volumes import Volume
from . import axial, style
from .rois import draw_slice, name_regions, outline, slice_panels

UNUSED = "#BBBBBB"
AROUND = 0.12  # margin around the scanned box, relative to its size


@style.styled()
def draw(
    image: Volume,
    slices: Sequence[int],
    used: Sequence[Mapping[str, np.ndarray]],
    unused: Sequence[Mapping[str, np.ndarray]],
    tissue_class: Mapping[str, str],
    box_mm: Sequence[Sequence[float]],
) -> Figure:
    """Draw slices of a CT with outlines of regions.

    Parameters
    ----------
    image : Volume
        CT, HU.
    slices : sequence of int
        Indices of the slices.
    used, unused : sequence of mapping of str to ndarray of bool, shape (y, x)
        For each slice, {name: mask} of the regions that become ROIs and of the others.
    tissue_class : mapping of str to str
        {ROI: class}.
    box_mm : sequence
        Scanned box, [[x, x], [y, y]], NIfTI world mm, drawn as a dashed line.
    """
    colors = style.assign(tissue_class.values(), style.ON_GRAY_IMAGE)
    box = _around(box_mm, image)
    figure, panels, line = slice_panels(len(slices), box, 2 * 19.0, 9.0)
    unused_visible = False  # an unused region, such as an arm, may be outside of the drawn part
    for axes, z, rois, others in zip(panels, slices, used, unused, strict=False):
        draw_slice(axes, image, z, box)
        for mask in others.values():
            outline(axes, mask, image.grid, UNUSED)
            unused_visible |= _in_box(mask, image, box)
        for name, mask in rois.items():
            outline(axes, mask, image.grid, colors[tissue_class[name]])
        (x_low, x_high), (y_low, y_high) = box_mm
        axes.add_patch(
            Rectangle((x_low, y_low), x_high - x_low, y_high - y_low, fill=False, edgecolor="white", linestyle="--")
        )
        name_regions(axes, rois, image.grid, line)
    for axes in panels[len(slices) :]:
        axes.remove()
    handles = [Line2D([], [], color=color, label=style.label(name)) for name, color in colors.items()]
    if unused_visible:
        handles.append(Line2D([], [], color=UNUSED, label="not used"))
    handles.append(Line2D([], [], color="black", linestyle="--", label="scanned box"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5))
    return figure


def _in_box(mask: np.ndarray, image: Volume, box: Sequence[float]) -> bool:
    """Return whether a mask (y, x) has a pixel in a box from `_around`."""
    _, y, x = image.grid.axes_mm()
    x_mm, y_mm = x + image.grid.centre_mm[0], y + image.grid.centre_mm[1]
    inside = np.outer((box[2] <= y_mm) & (y_mm <= box[3]), (box[0] <= x_mm) & (x_mm <= box[1]))
    return bool((inside & mask).any())


def _around(box_mm: Sequence[Sequence[float]], image: Volume) -> tuple[float, float, float, float]:
    """Return the scanned box with a margin, within the CT: x low, x high, y low, y high."""
    edges = axial.edges_mm(image.grid)
    margin = AROUND * max(high - low for low, high in box_mm)
    (x_low, x_high), (y_low, y_high) = box_mm
    low_x, low_y = max(x_low - margin, edges[0]), max(y_low - margin, edges[2])
    return low_x, min(x_high + margin, edges[1]), low_y, min(y_high + margin, edges[3])
