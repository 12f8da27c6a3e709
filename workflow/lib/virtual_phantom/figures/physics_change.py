"""Stability of every feature with and without the physics of the study."""

from collections.abc import Mapping

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..statistics.stability_measures import UNVARYING
from . import style, tables
from .labels import label_points, marker_boxes

NUMBERS = ["without_percent", "with_percent", "change_percent", "without_low", "without_high", "with_low", "with_high"]
NAMED = 8  # named features: those with the largest significant changes
ROUND_PERCENT, EDGE_PERCENT = 20, 4  # axes end EDGE_PERCENT beyond a multiple of ROUND_PERCENT


@style.styled(grid=True)
def draw(table: pandas.DataFrame, threshold: float, noise: Mapping[str, float | None] | None = None) -> Figure:
    """Draw one point per feature, by family, and the line of no change.

    Features with a significant change have the 95 % intervals of both values. The NAMED largest changes are numbered.

    Parameters
    ----------
    table : DataFrame
        From `statistics.physics_change.stability_change`.
    threshold : float
        A pair is stable if |W| is below this value.
    noise : mapping of str to float or None, optional
        {noise level: A}, for the text.

    Raises
    ------
    InputError
        If columns or rows are missing.
    """
    table = table[table["changed"] != UNVARYING]
    text = ["feature", "family", "changed"]
    tables.check_table(table, "table of physics_change", text=text, numbers=NUMBERS[:3])
    figure = style.figure(style.DOUBLE_COLUMN_MM, 105)
    axes, text_axes = figure.subplots(1, 2, width_ratios=(1.25, 1))
    same = axes.axline((0, 0), slope=1, color=style.GREY, linestyle="--", linewidth=0.9, zorder=1, label="no change")
    changed = table[table["changed"] == "yes"].sort_values(
        "change_percent", key=lambda change: -change.abs(), kind="stable"
    )
    positions = changed[NUMBERS[:2]].to_numpy(float)
    if len(changed):
        intervals = (changed[["without_low", "without_high"]], changed[["with_low", "with_high"]])
        x_error, y_error = (np.abs(ends.to_numpy(float).T - positions[:, k]) for k, ends in enumerate(intervals))
        bars = {"fmt": "none", "ecolor": style.GREY, "elinewidth": 0.6, "zorder": 1}
        axes.errorbar(*positions.T, xerr=x_error, yerr=y_error, **bars)
    found = style.scatter_families(axes, table, *NUMBERS[:2], sorted(set(table["family"])))
    highest = np.nanmax([table[NUMBERS[:2]].to_numpy(float).max(), *changed[["without_high", "with_high"]].max()])
    ends = -EDGE_PERCENT, ROUND_PERCENT * max(1, np.ceil(highest / ROUND_PERCENT)) + EDGE_PERCENT
    axes.set(xlim=ends, ylim=ends, aspect="equal")
    axes.set_xlabel(f"without physics: pairs of groups with |W| < {threshold:g} (%)")
    axes.set_ylabel(f"with physics: pairs of groups with |W| < {threshold:g} (%)")
    means = [table[name].mean() for name in NUMBERS[:2]]
    axes.set_title(
        f"{len(changed)} of {len(table)} features change\nmeans: {means[0]:.1f} % without, {means[1]:.1f} % with"
    )
    figure.legend(handles=[same, *found], loc="outside upper center", ncols=6)
    figure.draw_without_rendering()  # fixes the layout, on which the placement of numbers depends
    _number(axes, table, positions[:NAMED])
    text_axes.axis("off")
    text_axes.text(0, 1, "\n".join(_text(changed, noise)), ha="left", va="top", linespacing=1.4)
    return figure


def _number(axes: Axes, table: pandas.DataFrame, positions: np.ndarray) -> None:
    """Number the positions; equal positions share a label."""
    if not len(positions):
        return
    distinct = np.unique(positions, axis=0)
    members = [np.flatnonzero((positions == position).all(axis=1)) for position in distinct]
    names = [", ".join(str(member + 1) for member in group) for group in members]
    label_points(axes, names, distinct, marker_boxes(axes, table[NUMBERS[:2]].to_numpy(float)))


def _text(changed: pandas.DataFrame, noise: Mapping[str, float | None] | None) -> list[str]:
    """Return the lines of text next to the axes."""
    lines = []
    if noise:
        lines.append(style.noise_sentence(noise))
    lines += ["Bars: 95 % intervals of both values, for features", "with a significant change."]
    if not len(changed):
        return [*lines, "", "No feature changes significantly."]
    most = "" if len(changed) <= NAMED else f", the {NAMED} largest of {len(changed)}"
    lines += ["", f"Change in percentage points{most}:"]
    for number, (_, row) in enumerate(changed[:NAMED].iterrows(), 1):
        points = f"{row['change_percent']:+.0f}".replace("-", "\N{MINUS SIGN}")
        lines.append(f"{number}  {style.feature_label(row['feature'])}, {points}")
    return lines
