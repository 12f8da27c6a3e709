"""Stability of every feature with the study's physics, against that without."""

from collections.abc import Mapping

import numpy as np
import pandas
import seaborn
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D

from . import style, tables
from .labels import place_labels
from .stability_discrimination import LETTER, POINT

NUMBERS = ["without_percent", "with_percent", "change_percent", "without_low", "without_high", "with_low", "with_high"]
NAMED = 8  # features with the largest change that is no chance, named beside the axes
ROUND_PERCENT, EDGE_PERCENT = 20, 4  # axes end at a multiple of the one, and the other beyond


@style.styled(grid=True)
def draw(table: pandas.DataFrame, threshold: float, noise: Mapping[str, float | None] | None = None) -> Figure:
    """A point per feature, by family, on or off the line of no change.

    Those that change by more than chance have the 95 % intervals of both values, and the NAMED largest a number.

    Parameters
    ----------
    table : DataFrame
        As `statistics.physics_change.table` gives it.
    threshold : float
        Of |W|, under which a pair is stable.
    noise : mapping of str to float or None, optional
        A of the noise level, by name; to be said.

    Raises
    ------
    InputError
        If columns or rows lack.
    """
    text = ["feature", "family", "changed"]
    tables.check_table(table, "table of physics_change", text=text, numbers=NUMBERS[:3])
    families = sorted(set(table["family"]))
    figure = style.figure(style.DOUBLE_COLUMN_MM, 105)
    axes, beside = figure.subplots(1, 2, width_ratios=(1.25, 1))
    axes.axline((0, 0), slope=1, color=style.GREY, linestyle="--", linewidth=0.9, zorder=1, label="no change")
    changed = table[table["changed"] == "yes"].sort_values(
        "change_percent", key=lambda change: -change.abs(), kind="stable"
    )
    places = changed[NUMBERS[:2]].to_numpy(float)
    if len(changed):
        reach = [
            np.abs(changed[NUMBERS[at : at + 2]].to_numpy(float).T - places[:, which]) for which, at in ((0, 3), (1, 5))
        ]
        bars = {"fmt": "none", "ecolor": style.GREY, "elinewidth": 0.6, "zorder": 1}
        axes.errorbar(*places.T, xerr=reach[0], yerr=reach[1], **bars)
    seaborn.scatterplot(
        table,
        x="without_percent",
        y="with_percent",
        hue="family",
        hue_order=families,
        style="family",
        palette=style.assign(families, style.ON_WHITE),
        markers=style.assign(families, style.MARKERS),
        alpha=0.75,
        linewidth=0.4,
        ax=axes,
        zorder=2,
    )
    axes.get_legend().remove()
    highest = np.nanmax([table[NUMBERS[:2]].to_numpy(float).max(), *changed[["without_high", "with_high"]].max()])
    ends = -EDGE_PERCENT, ROUND_PERCENT * max(1, np.ceil(highest / ROUND_PERCENT)) + EDGE_PERCENT
    axes.set(xlim=ends, ylim=ends, aspect="equal")
    axes.set_xlabel(f"without physics: pairs of groups with |W| < {threshold:g} (%)")
    axes.set_ylabel(f"with it: pairs of groups with |W| < {threshold:g} (%)")
    means = [table[name].mean() for name in NUMBERS[:2]]
    axes.set_title(
        f"{len(changed)} of {len(table)} features change\nmeans: {means[0]:.1f} % without, {means[1]:.1f} % with"
    )
    handles, _ = axes.get_legend_handles_labels()
    figure.legend(handles, ["no change", *map(style.family_label, families)], loc="outside upper center", ncols=6)
    figure.draw_without_rendering()  # numbers are put where there is room, which the layout decides
    _number(axes, table, places[:NAMED])
    beside.axis("off")
    beside.text(0, 1, "\n".join(_said(changed, noise)), ha="left", va="top", linespacing=1.4)
    return figure


def _number(axes: Axes, table: pandas.DataFrame, places: np.ndarray) -> None:
    """Numbers where there is room beside the first places, one label for those that are one."""
    if not len(places):
        return
    to_points = axes.transData + axes.get_figure().dpi_scale_trans.inverted() + Affine2D().scale(72)
    middles = np.unique(places, axis=0)
    names = [", ".join(str(one + 1) for one in np.flatnonzero((places == middle).all(axis=1))) for middle in middles]
    sizes = np.array([(LETTER * len(name), style.FONT_POINTS) for name in names])
    frame = to_points.transform(np.transpose([axes.get_xlim(), axes.get_ylim()])).ravel()
    points = to_points.transform(table[NUMBERS[:2]].to_numpy(float))
    obstacles = [(x - POINT / 2, y - POINT / 2, x + POINT / 2, y + POINT / 2) for x, y in points]
    placed = to_points.inverted().transform(place_labels(to_points.transform(middles), sizes, obstacles, frame))
    for name, place in zip(names, placed, strict=True):
        axes.text(*place, name, ha="center", va="center", zorder=4)


def _said(changed: pandas.DataFrame, noise: Mapping[str, float | None] | None) -> list[str]:
    """The lines beside the axes."""
    lines = []
    if noise:
        level = style.noise_levels(noise)
        lines.append(f"{level[0].upper()}{level[1:]}.")
    lines += ["Bars: 95 % intervals of both values, where", "that of their difference does not hold 0."]
    if not len(changed):
        return [*lines, "", "No feature changes."]
    most = "" if len(changed) <= NAMED else f", the {NAMED} largest of {len(changed)}"
    lines += ["", f"Change in percentage points{most}:"]
    for number, (_, row) in enumerate(changed[:NAMED].iterrows(), 1):
        points = f"{row['change_percent']:+.0f}".replace("-", "\N{MINUS SIGN}")
        lines.append(f"{number}  {style.feature_label(row['feature'])}, {points}")
    return lines
