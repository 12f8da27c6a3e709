"""A diagnosis in pictures: where recording and model differ, before and after, and how the candidates did."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

import numpy as np
import seaborn
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from ..io.volumes import Volume
from . import axial, style

MAP_LIMIT = 6.0  # standard deviations: beyond them colours stay the same
BEFORE, AFTER = style.VERMILLION, style.BLUE
MOST_RANKED = 18
LINEAR_SD = 5.0  # residuals; the axis is linear below
LINEAR_GAIN = 1.0  # log score; the axis of gains is linear below
FIRST_ORDER_ALPHA = 0.4  # of bars of what was not fitted
LINE_INTEGRALS = "line integrals"  # of draw_setup: what of a recording is drawn


def _plain(axis: Axis) -> None:
    """Few numbers, written out: the shared style sets no formulas."""
    axis.get_major_locator().set_params(numticks=6)
    axis.set_major_formatter(_written())


def _written() -> FuncFormatter:
    return FuncFormatter(lambda value, _: style.number(value))


def _residual_ticks(low: float, high: float) -> np.ndarray:
    """0 and powers of ten, at most three to a side: 1 would lie on 0. Round numbers where no residual reaches 10."""
    furthest = max(-low, high)
    if furthest < 10:
        ticks = MaxNLocator(5).tick_values(low, high)
    else:
        powers = 10 ** np.arange(np.floor(np.log10(furthest)), 0, -1)
        powers = powers[:: -(-len(powers) // 3)]
        ticks = np.concatenate([-powers, [0], powers[::-1]])
    return ticks[(ticks >= low) & (ticks <= high)]


def bars(axes: Axes, values: Mapping[str, float], chosen: tuple[str, ...]) -> None:
    """A horizontal bar for each, in its order, named; those that were chosen are blue."""
    colours = {True: AFTER, False: "#BBBBBB"}
    named = {
        "x": list(values.values()),
        "y": list(map(style.label, values)),
        "hue": [name in chosen for name in values],
    }
    seaborn.barplot(**named, palette=colours, saturation=1, width=0.7, legend=False, ax=axes)
    axes.axvline(0, color=style.GREY, linewidth=0.6)


@style.styled()
def draw_setup(stated: np.ndarray, best: np.ndarray, title: str, of: str = LINE_INTEGRALS) -> Figure:
    """What two descriptions of a recording leave of it, each on a scale of its own.

    Parameters
    ----------
    stated, best : ndarray, shape (views, columns)
        Recorded less simulated.
    of : str, optional
        What: LINE_INTEGRALS, or HU of a slice.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 68)
    axes = figure.subplots(1, 2)
    for index, (place, values, name) in enumerate(
        zip(axes, (stated, best), ("as described", "as it fits best"), strict=True)
    ):
        limit = max(float(np.quantile(np.abs(values), 0.995)), 1e-6)
        lines = of == LINE_INTEGRALS
        aspect = "auto" if lines else "equal"
        shown = place.imshow(values, aspect=aspect, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
        place.set(xlabel="detector column, of those compared" if lines else "x, coarse voxels", title=name)
        figure.colorbar(shown, ax=place, label="line integral" if lines else "HU", extend="both", shrink=0.9)
        style.letter_panel(place, index)
    axes[0].set_ylabel("view, of those compared" if of == LINE_INTEGRALS else "y, coarse voxels")
    figure.suptitle(title)
    return figure


@style.styled()
def draw_maps(
    before: np.ndarray,
    after: np.ndarray,
    title: str,
    across: str,
    down: str,
    *,
    image: bool = False,
    steps: tuple[int, int] = (1, 1),
) -> Figure:
    """Standardised residuals, before and after, on one scale.

    Parameters
    ----------
    before, after : ndarray, shape (down, across)
        Standard deviations.
    across, down : str
        Labels of the axes.
    image : bool, optional
        Whether both axes are of one length unit, so that shapes are to be seen as they are.
    steps : tuple of 2 int, optional
        How many of the recording's places a place of the maps stands for, down and across: axes have the recording's
        numbers.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 68)
    axes = figure.subplots(1, 2, sharey=True)
    down_end, across_end = (step * n - 0.5 for step, n in zip(steps, before.shape, strict=True))
    for index, (place, values, name) in enumerate(
        zip(axes, (before, after), ("alignment only", "with the effects found"), strict=True)
    ):
        shown = place.imshow(
            values,
            aspect="equal" if image else "auto",
            cmap="RdBu_r",
            vmin=-MAP_LIMIT,
            vmax=MAP_LIMIT,
            interpolation="nearest",
            extent=(-0.5, across_end, down_end, -0.5),
        )
        place.set(xlabel=across, title=name)
        style.letter_panel(place, index)
    axes[0].set_ylabel(down)
    figure.colorbar(shown, ax=axes, label="recorded − modelled (standard deviations)", extend="both", shrink=0.9)
    figure.suptitle(title)
    return figure


@style.styled(grid=True)
def draw_profiles(panels: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """Residuals along something, before and after.

    Parameters
    ----------
    panels : list of tuple
        (label of x, x, before, after) of each: a str and three ndarrays of shape (points,), the residuals in standard
        deviations. Points where both are 0 are left out.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 58)
    for index, (axes, (label, x, before, after)) in enumerate(
        zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True)
    ):
        axes.axhspan(-2, 2, color="#EEEEEE")
        there = (before != 0) | (after != 0)  # not views that were fitted, or rows without a ray
        axes.plot(x[there], before[there], color=BEFORE, label="alignment only")
        axes.plot(x[there], after[there], color=AFTER, label="with the effects found")
        axes.set_yscale("symlog", linthresh=LINEAR_SD)
        axes.set_yticks(_residual_ticks(*axes.get_ylim()))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(_written())
        axes.set(xlabel=label, ylabel="recorded − modelled (SD)" if index == 0 else None)
        style.letter_panel(axes, index)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@style.styled(grid=True)
def draw_ranking(gains: Mapping[str, float], chosen: tuple[str, ...], fitted: Container[str]) -> Figure:
    """Log score that every candidate alone adds on held-out data, the best first.

    Parameters
    ----------
    gains : dict of str to float
        By candidate; the best MOST_RANKED are shown.
    chosen : tuple of str
        Those in the verdict: blue.
    fitted : container of str
        Candidates that were fitted; what others gain is of first order: pale.
    """
    names = sorted(gains, key=lambda name: -gains[name])[:MOST_RANKED]
    figure = style.figure(style.DOUBLE_COLUMN_MM, 18 + 4.6 * len(names))
    axes = figure.subplots()
    bars(axes, {name: gains[name] for name in names}, chosen)
    for bar in axes.patches:  # those chosen come last
        name = names[round(bar.get_y() + bar.get_height() / 2)]
        bar.set_alpha(1.0 if name in fitted else FIRST_ORDER_ALPHA)
    axes.set_xscale("symlog", linthresh=LINEAR_GAIN)
    _plain(axes.xaxis)
    axes.set_xlabel(
        "gain on data not fitted (log score), each effect alone\nblue: in the verdict; pale: estimated, not fitted"
    )
    return figure


@style.styled()
def draw_pieces(scanned: Volume, pieces: Sequence[Mapping]) -> Figure:
    """Pieces of the object that differ from what was stated, each in the slice of its middle.

    Parameters
    ----------
    scanned : Volume
        What was stated, HU.
    pieces : sequence of mapping
        As diagnosis.json has them: x_mm, y_mm, z_mm, width_mm and hu.
    """
    down, across = (len(pieces) + 1) // 2, min(len(pieces), 2)
    figure = style.figure(style.SINGLE_COLUMN_MM * across, 66 * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    heights = scanned.grid.axes_mm()[0]
    for axes, one in zip(panels, pieces, strict=False):
        z = len(heights) // 2 if one["z_mm"] is None else int(np.argmin(np.abs(heights - one["z_mm"])))
        axial.show(axes, scanned.array[z], scanned.grid, axial.edges_mm(scanned.grid))
        x, y = np.array([one["x_mm"], one["y_mm"]]) + scanned.grid.centre_mm[:2]
        axes.add_patch(Circle((x, y), one["width_mm"] / 2, fill=False, color=style.ORANGE, linewidth=1.2))
        axes.set_title(f"{one['hu']:+.0f} HU, {one['width_mm']:.2g} mm wide")
        axial.scale_bar(axes)
    for axes in panels[len(pieces) :]:
        axes.remove()
    return figure


@style.styled(grid=False)
def draw_object(scanned: Volume) -> Figure:
    """What was scanned: its middle slice, in HU."""
    figure = style.figure(style.SINGLE_COLUMN_MM, 62)
    axes = figure.subplots()
    image = axial.show(axes, scanned.array[len(scanned.array) // 2], scanned.grid, axial.edges_mm(scanned.grid))
    axial.scale_bar(axes)
    figure.colorbar(image, ax=axes, label="CT number (HU)", shrink=0.9, pad=0.01)
    return figure
