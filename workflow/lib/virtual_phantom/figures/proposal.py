"""Slices of a CT with the regions that become ROIs, those that do not, and the box that is scanned."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ..io.volumes import Volume
from . import axial, style
from .rois import name_beside, outline

LEFT_OUT = "#BBBBBB"
AROUND = 0.12  # of the box, shown around it


@style.styled()
def draw(
    image: Volume,
    slices: Sequence[int],
    taken: Sequence[Mapping[str, np.ndarray]],
    left: Sequence[Mapping[str, np.ndarray]],
    tissue_class: Mapping[str, str],
    box_mm: Sequence[Sequence[float]],
) -> Figure:
    """Draw slices of a CT with outlines of regions.

    Parameters
    ----------
    image : Volume
        The CT, HU.
    slices : sequence of int
        Which of its slices.
    taken, left : sequence of mapping of str to ndarray of bool, shape (y, x)
        For each slice, the regions in it that become ROIs, and those that are left out: {name: mask}.
    tissue_class : mapping of str to str
        Of the former.
    box_mm : sequence
        What is scanned, [[x, x], [y, y]], NIfTI world mm: a dashed box.
    """
    colours = style.assign(tissue_class.values(), style.ON_GREY_IMAGE)
    box = _around(box_mm, image)
    columns = min(len(slices), 2)
    rows = -(-len(slices) // columns)
    width_mm = style.DOUBLE_COLUMN_MM if columns == 2 else 120.0
    names_mm, title_mm, legend_mm = 2 * 19.0, 7.0, 9.0
    panel_width_mm = width_mm / columns - names_mm
    panel_height_mm = panel_width_mm * (box[3] - box[2]) / (box[1] - box[0])
    figure = style.figure(width_mm, rows * (panel_height_mm + title_mm) + legend_mm)
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    seen = False  # whether an outline of what is left out lies in what is shown: an arm's does not
    line_mm = 1.35 * style.FONT_POINTS * style.MILLIMETRES_PER_POINT
    for axes, z, inside, outside in zip(panels, slices, taken, left, strict=False):
        axial.show(axes, image.array[z], image.grid, box)
        axial.mark_sides(axes)
        axial.scale_bar(axes)
        axes.set_title(f"z = {axial.slice_z_mm(image.grid, z):.1f} mm".replace("-", "−"))
        for mask in outside.values():
            outline(axes, mask, image.grid, LEFT_OUT)
            seen |= _in_box(mask, image, box)
        for name, mask in inside.items():
            outline(axes, mask, image.grid, colours[tissue_class[name]])
        (x_low, x_high), (y_low, y_high) = box_mm
        axes.add_patch(
            Rectangle((x_low, y_low), x_high - x_low, y_high - y_low, fill=False, edgecolor="white", linestyle="--")
        )
        name_beside(axes, inside, image.grid, line=line_mm / panel_height_mm)
    for axes in panels[len(slices) :]:
        axes.remove()
    handles = [Line2D([], [], color=colour, label=style.label(name)) for name, colour in colours.items()]
    if seen:
        handles.append(Line2D([], [], color=LEFT_OUT, label="left out"))
    handles.append(Line2D([], [], color="black", linestyle="--", label="what is scanned"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5))
    return figure


def _in_box(mask: np.ndarray, image: Volume, box: Sequence[float]) -> bool:
    """Whether a mask (y, x) has a pixel in a box as of `_around`."""
    _, y, x = image.grid.axes_mm()
    x_mm, y_mm = x + image.grid.centre_mm[0], y + image.grid.centre_mm[1]
    there = np.outer((box[2] <= y_mm) & (y_mm <= box[3]), (box[0] <= x_mm) & (x_mm <= box[1]))
    return bool((there & mask).any())


def _around(box_mm: Sequence[Sequence[float]], image: Volume) -> tuple[float, float, float, float]:
    """The box and a little more, but not beyond the CT: x low, x high, y low, y high."""
    edges = axial.edges_mm(image.grid)
    more = AROUND * max(high - low for low, high in box_mm)
    (x_low, x_high), (y_low, y_high) = box_mm
    return (
        max(x_low - more, edges[0]),
        min(x_high + more, edges[1]),
        max(y_low - more, edges[2]),
        min(y_high + more, edges[3]),
    )
