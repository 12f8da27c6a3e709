"""Figures of a diagnosis: residuals before and after, and the improvement in log score of each candidate."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator, NullLocator

from ..io.volumes import Volume
from . import axial, style
from .scans import round_up

BEFORE, AFTER = style.VERMILLION, style.BLUE
LINES = {
    "before": {"color": BEFORE, "linestyle": "--", "label": "alignment only"},
    "after": {"color": AFTER, "label": "with the effects found"},
}
MOST_RANKED = 18
LINEAR_SD = 5.0  # residuals; the axis is linear below
LINEAR_GAIN = 1.0  # log score; the axis of improvements is linear below
ADDED = {"color": "black", "markeredgecolor": "white", "markersize": 5}  # marker of an effect beside the others
FIRST_ORDER_ALPHA = 0.4  # of bars of first-order estimates
LINE_INTEGRALS = "line integrals"  # kind of residuals in draw_setup


def _residual_ticks(low: float, high: float) -> np.ndarray:
    """Return 0 and at most three powers of ten per sign, without 1, or round numbers below 10."""
    furthest = max(-low, high)
    if furthest < 10:
        ticks = MaxNLocator(5).tick_values(low, high)
    else:
        powers = 10 ** np.arange(np.floor(np.log10(furthest)), 0, -1)
        powers = powers[:: -(-len(powers) // 3)]
        ticks = np.concatenate([-powers, [0], powers[::-1]])
    return ticks[(ticks >= low) & (ticks <= high)]


def bars(axes: Axes, values: Mapping[str, float], chosen: tuple[str, ...]) -> None:
    """Draw a horizontal bar for each candidate in the given order, blue for the chosen candidates."""
    colors = [AFTER if name in chosen else "#BBBBBB" for name in values]
    style.bars(axes, list(map(style.label, values)), list(values.values()), colors, height=0.7)
    axes.axvline(0, color=style.GREY, linewidth=0.6)


@style.styled()
def draw_setup(
    stated: np.ndarray,
    best: np.ndarray,
    title: str,
    quantity: str = LINE_INTEGRALS,
    names: tuple[str, str] = ("as described", "as corrected"),
) -> Figure:
    """Draw the residuals of a recording with the described and with the corrected scan set-up, on separate scales.

    Parameters
    ----------
    stated, best : ndarray, shape (views, columns)
        Recorded minus simulated values.
    quantity : str, optional
        LINE_INTEGRALS, or HU of a slice.
    names : tuple of 2 str, optional
        Titles of the panels, if other maps are drawn.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 68)
    axes = figure.subplots(1, 2)
    for index, (panel, values, name) in enumerate(zip(axes, (stated, best), names, strict=True)):
        limit = max(float(np.quantile(np.abs(values), 0.995)), 1e-6)
        lines = quantity == LINE_INTEGRALS
        aspect = "auto" if lines else "equal"
        image = panel.imshow(values, aspect=aspect, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
        panel.set(xlabel="compared detector columns" if lines else "x (coarse voxels)", title=name)
        figure.colorbar(image, ax=panel, label="line integral" if lines else "HU", extend="both", shrink=0.9)
        style.letter_panel(panel, index)
    axes[0].set_ylabel("compared views" if quantity == LINE_INTEGRALS else "y (coarse voxels)")
    figure.suptitle(title)
    return figure


@dataclass(frozen=True)
class MapAxes:
    """Axes of maps of a recording.

    Attributes
    ----------
    across, down : str
        Labels.
    image : bool
        Whether both axes have the same length unit, which gives square pixels.
    steps : tuple of 2 int
        Size of a map pixel in pixels of the recording, down and across. The axes count pixels of the recording.
    """

    across: str
    down: str
    image: bool = False
    steps: tuple[int, int] = (1, 1)

    def show(self, panel: Axes, values: np.ndarray, **look) -> AxesImage:
        """Draw a map, shape (down, across)."""
        down_end, across_end = (step * n - 0.5 for step, n in zip(self.steps, values.shape, strict=True))
        place = {"aspect": "equal" if self.image else "auto", "extent": (-0.5, across_end, down_end, -0.5)}
        return panel.imshow(values, interpolation="nearest", **place, **look)


def _unsaturated(before: np.ndarray, after: np.ndarray) -> tuple[SymLogNorm, list[float]]:
    """Return a color scale for residuals before and after, and its ticks.

    It ends beyond the largest residual. It is linear up to twice the RMS after, so that both maps show their structure.
    """
    limit = round_up(max(np.nanmax(np.abs(before)), np.nanmax(np.abs(after))))
    linear = min(max(2 * float(np.sqrt(np.nanmean(after**2))), 1e-3 * limit), limit / 2)
    linear = 10.0 ** np.floor(np.log10(linear)) * np.floor(linear / 10.0 ** np.floor(np.log10(linear)))
    return SymLogNorm(linear, vmin=-limit, vmax=limit), [-limit, -linear, 0, linear, limit]


def _residuals(panels: Sequence[Axes], axes: MapAxes, before: np.ndarray, after: np.ndarray, unit: str, first: int):
    """Draw residuals before and after in two panels with one color scale, with letters from index `first`."""
    norm, ticks = _unsaturated(before, after)
    for index, (panel, values, name) in enumerate(
        zip(panels, (before, after), ("alignment only", "with the effects found"), strict=True)
    ):
        shown = axes.show(panel, values, cmap="RdBu_r", norm=norm)
        panel.set_xlabel(axes.across)
        style.letter_panel(panel, first + index, name)
    panels[0].set_ylabel(axes.down)
    bar = panels[0].figure.colorbar(
        shown, ax=list(panels), label=f"recorded − modeled\n({unit})", ticks=ticks, shrink=0.95, aspect=15
    )
    bar.ax.minorticks_off()
    bar.ax.yaxis.set_major_formatter(style.number_formatter())


@style.styled()
def draw_data(
    recorded: np.ndarray, before: np.ndarray, after: np.ndarray, title: str, axes: MapAxes, unit: str
) -> Figure:
    """Draw a recording, its model with the effects found, and the residuals before and after the diagnosis.

    Parameters
    ----------
    recorded, before, after : ndarray, shape (down, across)
        Recorded data, and recorded minus modeled data, in `unit`. NaN is not drawn.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 116)
    (top, bottom) = figure.subplots(2, 2, sharex=True, sharey=True)
    low, high = axial.WINDOW_HU if axes.image else (np.nanmin(recorded), np.nanmax(recorded))
    for index, (panel, values, name) in enumerate(
        zip(top, (recorded, recorded - after), ("recorded", "modeled, with the effects found"), strict=True)
    ):
        shown = axes.show(panel, values, cmap="gray", vmin=low, vmax=high)
        style.letter_panel(panel, index, name)
    top[0].set_ylabel(axes.down)
    figure.colorbar(shown, ax=list(top), label=unit, shrink=0.95, aspect=15)
    _residuals(bottom, axes, before, after, unit, 2)
    figure.suptitle(title)
    return figure


@style.styled()
def draw_maps(before: np.ndarray, after: np.ndarray, title: str | None, axes: MapAxes, first: int = 0) -> Figure:
    """Draw the standardized residuals before and after the diagnosis, on one color scale.

    Parameters
    ----------
    before, after : ndarray, shape (down, across)
        Residuals in standard deviations.
    first : int, optional
        Index of the first panel's letter.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 64)
    _residuals(figure.subplots(1, 2, sharey=True), axes, before, after, "standard deviations", first)
    figure.suptitle(title)
    return figure


@style.styled(grid=True)
def draw_image_profile(profile: Mapping[str, Sequence[float]], first: int = 0) -> Figure:
    """Draw the reconstructed profile through the object before and after the diagnosis, and its differences.

    Parameters
    ----------
    profile : mapping of str to sequence of float
        From `diagnosis.comparison.relevance.middle_profile` by image: x_mm, recorded, before, after (HU).
    first : int, optional
        Index of the first panel's letter.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 62)
    panels = figure.subplots(1, 2, sharex=True)
    x, recorded = (np.array(profile[name]) for name in ("x_mm", "recorded"))
    panels[0].plot(x, recorded, color="black", label="recorded")
    panels[1].axhline(0, color="black")
    for name, look in LINES.items():
        panels[0].plot(x, profile[name], **look)
        panels[1].plot(x, recorded - np.array(profile[name]), **look)
    for index, (axes, label) in enumerate(zip(panels, ("mean CT number (HU)", "recorded − modeled (HU)"), strict=True)):
        axes.set(xlabel="x through the middle of the object (mm)", ylabel=label)
        style.letter_panel(axes, first + index)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@style.styled(grid=True)
def draw_profiles(panels: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]], first: int = 0) -> Figure:
    """Draw profiles of the residuals before and after the diagnosis.

    Parameters
    ----------
    panels : list of tuple
        (label of x, x, before, after) of each panel: a str and three ndarrays of shape (points,), with the residuals in
        standard deviations. Points where both residuals are 0 are not drawn.
    first : int, optional
        Index of the first panel's letter.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 58)
    for index, (axes, (label, x, before, after)) in enumerate(
        zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True)
    ):
        axes.axhspan(-2, 2, color="#EEEEEE")
        evaluated = (before != 0) | (after != 0)  # fitted views and rows without a ray have residuals of 0
        for values, look in zip((before, after), LINES.values(), strict=True):
            axes.plot(x[evaluated], values[evaluated], **look)
        axes.set_yscale("symlog", linthresh=LINEAR_SD)
        axes.set_yticks(_residual_ticks(*axes.get_ylim()))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(style.number_formatter())
        axes.set(xlabel=label, ylabel="recorded − modeled (SD)" if index == 0 else None)
        style.letter_panel(axes, first + index)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@style.styled(grid=True)
def draw_ranking(gains: Mapping[str, float], added: Mapping[str, float], fitted: Container[str]) -> Figure:
    """Draw the improvement in log score of every candidate alone, the largest first.

    Parameters
    ----------
    gains : dict of str to float
        Improvement of each candidate. The MOST_RANKED largest are drawn.
    added : dict of str to float
        Improvement by each effect in the verdict when it is added to the others. These effects are drawn in blue.
    fitted : container of str
        Candidates that were fitted. The others have first-order estimates and are drawn pale.
    """
    names = sorted(gains, key=lambda name: -gains[name])[:MOST_RANKED]
    figure = style.figure(style.DOUBLE_COLUMN_MM, 18 + 4.6 * len(names))
    axes = figure.subplots()
    bars(axes, {name: gains[name] for name in names}, tuple(added))
    marked = [name for name in names if name in added]
    axes.plot([added[name] for name in marked], [names.index(name) for name in marked], "D", **ADDED)
    for name, bar in zip(names, axes.patches, strict=True):
        bar.set_alpha(1.0 if name in fitted else FIRST_ORDER_ALPHA)
    axes.set_xscale("symlog", linthresh=LINEAR_GAIN)
    # Few ticks, with numbers in full, because the shared style has no exponents.
    axes.xaxis.get_major_locator().set_params(numticks=6)
    axes.xaxis.set_major_formatter(style.number_formatter())
    axes.set_xlabel(
        "improvement in log score, each effect alone (pale: first-order estimate)\n"
        "blue: in the verdict; diamond: added to the other effects of the verdict"
    )
    return figure


@style.styled()
def draw_pieces(scanned: Volume, pieces: Sequence[Mapping]) -> Figure:
    """Draw the local object mismatches, each in the slice of its center.

    Parameters
    ----------
    scanned : Volume
        The described object, HU.
    pieces : sequence of mapping
        Mismatches of diagnosis.json with the keys x_mm, y_mm, z_mm, width_mm and hu.
    """
    down, across = (len(pieces) + 1) // 2, min(len(pieces), 2)
    figure = style.figure(style.SINGLE_COLUMN_MM * across, 66 * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    heights = scanned.grid.axes_mm()[0]
    for axes, piece in zip(panels, pieces, strict=False):
        z = len(heights) // 2 if piece["z_mm"] is None else int(np.argmin(np.abs(heights - piece["z_mm"])))
        axial.show(axes, scanned.array[z], scanned.grid, axial.edges_mm(scanned.grid))
        x, y = np.array([piece["x_mm"], piece["y_mm"]]) + scanned.grid.centre_mm[:2]
        axes.add_patch(Circle((x, y), piece["width_mm"] / 2, fill=False, color=style.ORANGE, linewidth=1.2))
        axes.set_title(f"{piece['hu']:+.0f} HU, {piece['width_mm']:.2g} mm wide")
        axial.scale_bar(axes)
    for axes in panels[len(pieces) :]:
        axes.remove()
    return figure


@style.styled(grid=False)
def draw_object(scanned: Volume) -> Figure:
    """Draw the middle slice of the scanned object, in HU."""
    figure = style.figure(style.SINGLE_COLUMN_MM, 62)
    axes = figure.subplots()
    image = axial.show(axes, scanned.array[len(scanned.array) // 2], scanned.grid, axial.edges_mm(scanned.grid))
    axial.scale_bar(axes)
    figure.colorbar(image, ax=axes, label="CT number (HU)", shrink=0.9, pad=0.01)
    return figure
