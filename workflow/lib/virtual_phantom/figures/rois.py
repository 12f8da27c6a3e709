"""Regions of interest on axial slices of the phantom (figure 1 of Flouris et al., Sci. Rep. 2022)."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.volumes import Volume
from . import axial, style

LETTER_MM = 0.62 * style.FONT_POINTS * style.MILLIMETRES_PER_POINT  # mean width of a letter
TITLE_MM = 7.0  # height of the title of a panel
LEADER = {
    "arrowstyle": "-",
    "color": "white",
    "linewidth": 0.6,
    "path_effects": axial.OUTLINED,
    "shrinkA": 0,
    "shrinkB": 0,
}


@style.styled()
def draw(phantom: Volume, masks: Mapping[str, np.ndarray], tissue_class: Mapping[str, str]) -> Figure:
    """Draw few axial slices that show all ROIs, outlined in the color of their tissue class and named.

    Parameters
    ----------
    phantom : Volume
        HU.
    masks : mapping of str to ndarray, shape (z, y, x)
        ROIs on the phantom's grid, non-zero inside.
    tissue_class : mapping of str to str
        {ROI: class}.

    Raises
    ------
    InputError
        If there is no ROI, a mask is empty or of another shape, or an ROI has no class.
    """
    for roi, mask in masks.items():
        if mask.shape != phantom.grid.shape:
            raise InputError(f"ROI {roi}: mask of shape {mask.shape} on a phantom of {phantom.grid.shape}; resample it")
        if roi not in tissue_class:
            raise InputError(f"ROI {roi}: has no tissue class; give it one in phantom/rois.csv")
    slices = sorted(axial.choose_slices(masks), reverse=True)
    box = axial.body_box_mm(phantom, slices)
    colors = style.assign((tissue_class[roi] for roi in masks), style.ON_GRAY_IMAGE)

    sides = [_sides({roi: mask[z] for roi, mask in masks.items()}, phantom.grid, np.mean(box[:2])) for z in slices]
    names_mm = sum(max(_widest_mm(names[side]) for names in sides) for side in (True, False))
    spare = len(slices) > 1 and len(slices) % 2 == 1  # whether a panel is free for the color bar
    figure, panels, line = slice_panels(len(slices), box, names_mm, 8.0, 0.0 if spare else 14.0)
    for index, (axes, z) in enumerate(zip(panels, slices, strict=False)):
        image = draw_slice(axes, phantom, z, box)
        if len(slices) > 1:
            style.letter_panel(axes, index)
        shown = {roi: mask[z] for roi, mask in masks.items() if mask[z].any()}
        for roi, mask in shown.items():
            outline(axes, mask, phantom.grid, colors[tissue_class[roi]])
        name_regions(axes, shown, phantom.grid, line)
    if spare:
        panels[-1].set_axis_off()
        color_bar_axes = panels[-1].inset_axes([0.1, 0.5, 0.8, 0.08])
        figure.colorbar(image, cax=color_bar_axes, orientation="horizontal", label="CT number (HU)")
    else:
        figure.colorbar(image, ax=panels.tolist(), label="CT number (HU)", shrink=0.8, pad=0.01, aspect=25)
    handles = [Line2D([], [], color=color, label=style.label(name)) for name, color in colors.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 6))
    return figure


def slice_panels(
    count: int, box_mm: Sequence[float], names_mm: float, legend_mm: float, color_bar_mm: float = 0.0
) -> tuple[Figure, np.ndarray, float]:
    """Create a figure with panels in one or two columns for slices of the same part of an image.

    Parameters
    ----------
    box_mm : sequence of 4 float
        Visible part, as from `axial.body_box_mm`.
    names_mm, legend_mm, color_bar_mm : float
        Width of the names next to each panel, height of the legend, and width of the color bar.

    Returns
    -------
    figure : Figure
    panels : ndarray of Axes
    line : float
        Height of a line of text, as a fraction of the panel's height.
    """
    columns = min(count, 2)
    rows = -(-count // columns)
    width_mm = style.DOUBLE_COLUMN_MM if columns == 2 else 120.0
    panel_width_mm = (width_mm - color_bar_mm) / columns - names_mm
    panel_height_mm = panel_width_mm * (box_mm[3] - box_mm[2]) / (box_mm[1] - box_mm[0])
    figure = style.figure(width_mm, rows * (panel_height_mm + TITLE_MM) + legend_mm)
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    return figure, panels, 1.35 * style.FONT_POINTS * style.MILLIMETRES_PER_POINT / panel_height_mm


def draw_slice(axes: Axes, image: Volume, z: int, box_mm: Sequence[float]) -> AxesImage:
    """Draw slice z with the patient's sides, a scale bar and its world z."""
    shown = axial.show(axes, image.array[z], image.grid, box_mm)
    axial.mark_sides(axes)
    axial.scale_bar(axes)
    axes.set_title(f"z = {axial.slice_z_mm(image.grid, z):.1f} mm".replace("-", "−"))
    return shown


def outline(axes: Axes, mask: np.ndarray, grid: Grid, color: str) -> None:
    """Outline a mask (y, x) at the edges of its voxels; padding closes the outline at the edge of the image."""
    x_low, x_high, y_low, y_high = axial.edges_mm(grid)
    _, dy, dx = grid.spacing
    x = np.linspace(x_low - dx / 2, x_high + dx / 2, grid.shape[2] + 2)
    y = np.linspace(y_low - dy / 2, y_high + dy / 2, grid.shape[1] + 2)
    axes.contour(x, y, np.pad(mask != 0, 1).astype(float), levels=[0.5], colors=[color], linewidths=1.1)


def _ends_mm(mask: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the ends of a mask (y, x) in the row of its centroid: ((x low, y), (x high, y)), mm."""
    rows, columns = np.nonzero(mask)
    row = rows[np.argmin(np.abs(rows - rows.mean()))]
    _, y, x = grid.axes_mm()
    ends = np.array([columns[rows == row].min(), columns[rows == row].max()])
    half = np.array([-0.5, 0.5]) * grid.spacing[2]
    return np.stack([x[ends] + half, np.full(2, y[row])], axis=1) + grid.centre_mm[:2]


def _sides(masks: Mapping[str, np.ndarray], grid: Grid, middle_mm: float) -> dict[bool, list[str]]:
    """Return the names of the ROIs on the patient's right (True) and left (False) of a slice."""
    on_right = {roi: _ends_mm(mask, grid)[:, 0].mean() > middle_mm for roi, mask in masks.items() if mask.any()}
    return {side: [roi for roi, right in on_right.items() if right == side] for side in (True, False)}


def _widest_mm(names: list[str]) -> float:
    """Return the width of the longest name with its margin, mm."""
    return 3.0 + LETTER_MM * max((len(style.label(name)) for name in names), default=0)


def name_regions(axes: Axes, masks: Mapping[str, np.ndarray], grid: Grid, line: float) -> None:
    """Write the names of ROIs on both sides of a panel, near their heights and at least `line` apart.

    Masks have the shape (y, x). `line` is the height of a line of text as a fraction of the panel's height.
    """
    low, high = axes.get_ylim()
    sides = _sides(masks, grid, np.mean(axes.get_xlim()))
    for x_text, align, patient_right in ((-0.02, "right", True), (1.02, "left", False)):
        side = {roi: tuple(_ends_mm(masks[roi], grid)[1 if patient_right else 0]) for roi in sides[patient_right]}
        order = sorted(side, key=lambda roi: side[roi][1])
        heights = spread([(side[roi][1] - low) / (high - low) for roi in order], line)
        for roi, height in zip(order, heights, strict=True):
            axes.annotate(
                style.label(roi),
                xy=side[roi],
                xycoords="data",
                xytext=(x_text, height),
                textcoords="axes fraction",
                ha=align,
                va="center",
                arrowprops=LEADER,
            )


def spread(heights: list[float], gap: float) -> list[float]:
    """Increase the distances of ascending heights between 0 and 1 to at least `gap` (1/n if n heights do not fit)."""
    gap = min(gap, 1 / max(len(heights), 1))
    placed = []
    for height in heights:
        placed.append(max(height, placed[-1] + gap) if placed else max(height, gap / 2))
    ceiling = 1 - gap / 2
    for index in reversed(range(len(placed))):
        placed[index] = min(placed[index], ceiling)
        ceiling = placed[index] - gap
    return placed
