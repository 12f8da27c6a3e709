"""Axial views of the input and its reconstructions (figure 2 of Flouris et al., Sci. Rep. 2022)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from ..base.errors import InputError
from ..io.volumes import Volume
from . import axial, style


@style.styled()
def draw(
    phantom: Volume,
    reconstructions: Mapping[str, Volume],
    z: int,
    noise: Mapping[str, float | None] | None = None,
) -> Figure:
    """Draw slice z of the phantom and of each reconstruction, and the reconstructions minus the phantom.

    Titles give the root mean square difference of this slice inside the body (axial.body_mask of the phantom). The
    common window of the differences is the next round number above the 98th percentile of their absolute values inside
    the body.

    Parameters
    ----------
    phantom : Volume
        HU.
    reconstructions : mapping of str to Volume
        {title: volume}, HU, on the phantom's grid.
    noise : mapping of str to float or None, optional
        {noise level: A}, for the text.

    Raises
    ------
    InputError
        If there is no reconstruction, or one is on another grid or not finite in this slice.
    """
    if not reconstructions:
        raise InputError("figure of the scans: needs at least one reconstruction")
    original = phantom.array[z].astype(np.float64)
    body = axial.body_mask(original)
    differences = {}
    for title, volume in reconstructions.items():
        if not volume.grid.matches(phantom.grid):
            raise InputError(
                f"reconstruction {title}: grid {volume.grid} is not the phantom's {phantom.grid}; reconstruct it again"
            )
        differences[title] = volume.array[z].astype(np.float64) - original
        if not np.isfinite(differences[title]).all():
            raise InputError(f"reconstruction {title}: slice {z} has values that are not finite; reconstruct it again")
    limit = round_up(np.percentile(np.abs([difference[body] for difference in differences.values()]), 98))

    box = axial.body_box_mm(phantom, [z])
    columns = 1 + len(differences)
    panel_height_mm = style.DOUBLE_COLUMN_MM / columns * (box[3] - box[2]) / (box[1] - box[0])
    figure = style.figure(style.DOUBLE_COLUMN_MM, 2 * panel_height_mm + 18)
    panels = figure.subplots(2, columns)
    for index, (title, volume) in enumerate({"Input": phantom, **reconstructions}.items()):
        image = axial.show(panels[0, index], volume.array[z], phantom.grid, box)
        panels[0, index].set_title(title)
    axial.mark_sides(panels[0, 0])
    axial.scale_bar(panels[0, 0])
    for index, (title, difference) in enumerate(differences.items(), start=1):
        shown = axial.show(panels[1, index], difference, phantom.grid, box, (-limit, limit), "RdBu_r")
        root_mean_square = np.sqrt(np.mean(difference[body] ** 2))
        panels[1, index].set_title(f"{title} − input\nRMS {root_mean_square:.1f} HU in the body")
    for index, axes in enumerate([*panels[0], *panels[1, 1:]]):
        style.letter_panel(axes, index)
    text = f"single scans; axial slice, z = {axial.slice_z_mm(phantom.grid, z):.1f} mm".replace("-", "−")
    if noise:
        text += f"\n{style.noise_levels(noise)}"
    panels[1, 0].text(0.5, 0.98, text, transform=panels[1, 0].transAxes, ha="center", va="top")
    panels[1, 0].set_axis_off()
    color_bars = ((image, 0.58, "CT number (HU)"), (shown, 0.16, "difference from the input (HU)"))
    for mappable, bottom, label in color_bars:
        color_bar_axes = panels[1, 0].inset_axes([0.1, bottom, 0.8, 0.08])
        figure.colorbar(mappable, cax=color_bar_axes, orientation="horizontal", label=label)
    return figure


def round_up(value: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten; 1 for zero."""
    if value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value))
