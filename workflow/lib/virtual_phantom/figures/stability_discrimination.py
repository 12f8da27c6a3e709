"""Stability against discriminative power of every feature (figure 4 of Flouris et al., Sci. Rep. 2022)."""

from collections.abc import Mapping

import numpy as np
import pandas
import seaborn
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D, Transform
from scipy.cluster import hierarchy

from ..base.errors import InputError
from ..statistics.ranking import KINDS
from ..statistics.repeats import over_features
from . import style, tables
from .labels import place_labels

SCORES = [f"{kind}_percent" for kind in KINDS]
INTERVAL = ["ci95_low", "ci95_high"]
BEST = 5  # features named in each panel
NEAR_PERCENT = 4.0  # best features nearer to each other than this share one label
POINT = 4.0  # across, for one feature
LETTER = 0.64 * style.FONT_POINTS  # width of a digit with what is beside it
LINE = 1.45  # from line to line, of the type's size
ROUND_PERCENT, EDGE_PERCENT = 20, 4  # axes end at multiples of the one, and the other beyond


@style.styled(grid=True)
def draw(
    table: pandas.DataFrame,
    threshold: float,
    measured: pandas.DataFrame | None = None,
    *,
    repeats: int | None = None,
    sd: tuple[float, float] | None = None,
    intervals: pandas.DataFrame | None = None,
    noise: Mapping[str, float | None] | None = None,
) -> Figure:
    """A point per feature, by family; a second panel with measured scores of the same features, if given.

    Features of one family at one place are one marker, its area their number. The BEST features by the sum of both
    scores are numbered, and named under the panel.

    Parameters
    ----------
    table : DataFrame
        Columns feature, family, stability_percent, discrimination_percent.
    threshold : float
        Of |W|, under which a pair is stable and over which it is told apart; named on the axes.
    measured : DataFrame, optional
        Columns draw, repeats, of, feature, stability_percent, discrimination_percent (`statistics.repeats.draws`). What
        is shown are means over draws, and the SD over draws of the mean over features.
    repeats : int, optional
        Of each group of `table`, to be said.
    sd : tuple of float, optional
        SD of the mean over features of both scores of `table`, where it is known.
    intervals : DataFrame, optional
        Columns feature, ci95_low, ci95_high of the stability of `table`; drawn and said of the numbered features.
    noise : mapping of str to float or None, optional
        A of the noise level of `table`, by name; to be said.

    Raises
    ------
    InputError
        If columns or rows lack, a score is not a number, or the tables share no feature.
    """
    tables.check_table(table, "stability table", text=["feature", "family"], numbers=SCORES)
    if intervals is not None:
        # Of one repeat a group there are none.
        table = table.merge(intervals[["feature", *INTERVAL]].dropna(), on="feature", how="left")
    shown = {"Simulated": (table, repeats, sd)}
    if measured is not None:
        tables.check_table(measured, "measured scores", text=["feature"], numbers=["draw", "repeats", "of", *SCORES])
        measured = measured.drop(columns="family", errors="ignore").merge(table[["feature", "family"]], on="feature")
        if measured.empty:
            raise InputError("measured scores: share no feature with the stability table; name both as in pyradiomics")
        spreads = tuple(over_features(measured, kind)[1] for kind in KINDS)
        means = measured.groupby(["feature", "family"], sort=False)[SCORES].mean().reset_index()
        shown["Measured"] = (means, int(measured["repeats"].iloc[0]), spreads if np.isfinite(spreads).all() else None)
    families = sorted(set(table["family"]))

    double = len(shown) > 1
    figure = style.figure(style.DOUBLE_COLUMN_MM if double else style.SINGLE_COLUMN_MM, 120)
    panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
    for index, (axes, (title, (scores, repeats, sd))) in enumerate(zip(panels, shown.items(), strict=True)):
        _scatter(axes, scores, families)
        _name_best(axes, scores, noise if title == "Simulated" else None)
        stability, discrimination = scores[SCORES].mean()
        dashed = axes.axvline(stability, color=style.GREY, linestyle="--", linewidth=0.9, zorder=1)
        axes.axhline(discrimination, color=style.GREY, linestyle="--", linewidth=0.9, zorder=1)
        of_each = f", {repeats} repeats a group" if repeats else ""
        said = [f"{mean:.1f}" for mean in (stability, discrimination)]
        if sd is not None:
            said = [f"{mean} ± {spread:.1f}" for mean, spread in zip(said, sd, strict=True)]
        axes.set_title(f"{title}, {len(scores)} features{of_each}\nmeans: {said[0]} % stable, {said[1]} % told apart")
        if double:
            style.letter_panel(axes, index)
        axes.set(ylabel=None)
        axes.set_xlabel(f"stability: pairs of groups with |W| < {threshold:g} (%)")
    _limit(panels, [scores for scores, *_ in shown.values()])
    panels[0].set_ylabel(f"discriminative power: pairs across classes with |W| > {threshold:g} (%)")
    handles, _ = panels[0].get_legend_handles_labels()  # a heading, the families, and what seaborn says of sizes
    handles = [*handles[1 : 1 + len(families)], dashed]
    named = [*map(style.family_label, families), "mean of the features"]
    figure.legend(handles, named, loc="outside upper center", ncols=6 if double else 3, markerscale=1.4)
    figure.draw_without_rendering()  # numbers are put where there is room, which the layout decides
    for axes, (scores, *_) in zip(panels, shown.values(), strict=True):
        _number_best(axes, scores)
    return figure


def _scatter(axes: Axes, scores: pandas.DataFrame, families: list[str]) -> None:
    """A marker for each place of a family, its area the number of features there, large ones beneath."""
    markers = style.assign(families, style.MARKERS)
    places = scores.groupby(["family", *SCORES]).size().reset_index(name="count")
    places = places.sort_values("count", ascending=False, kind="stable")
    places["area"] = places["count"] * [style.marker_area(markers[family], POINT) for family in places["family"]]
    areas = {area: area for area in places["area"]}
    shown = {"hue": "family", "hue_order": families, "style": "family", "size": "area", "sizes": areas}
    look = {"palette": style.assign(families, style.ON_WHITE), "markers": markers, "alpha": 0.75, "linewidth": 0.4}
    seaborn.scatterplot(places, x=SCORES[0], y=SCORES[1], ax=axes, zorder=2, **shown, **look)
    axes.get_legend().remove()


def _limit(panels: np.ndarray, scores: list[pandas.DataFrame]) -> None:
    """The same axes in all panels, no longer than the points and their intervals need."""
    x, y = (pandas.concat([one[kind] for one in scores]) for kind in SCORES)
    ends = pandas.concat([x, *(one[INTERVAL[1]].dropna() for one in scores if INTERVAL[1] in one)])
    right = ROUND_PERCENT * max(1, np.ceil(ends.max() / ROUND_PERCENT))
    low = ROUND_PERCENT * min(4, np.floor(y.min() / ROUND_PERCENT))
    for axes in panels:
        axes.set(xlim=(-EDGE_PERCENT, right + EDGE_PERCENT), ylim=(low - EDGE_PERCENT, 100 + EDGE_PERCENT))


def best(scores: pandas.DataFrame) -> pandas.DataFrame:
    """The BEST rows by the sum of both scores, best first; of equal ones, the first by name."""
    both = scores.assign(both=scores[SCORES].sum(axis=1))
    return both.sort_values(["both", "feature"], ascending=[False, True]).head(BEST).reset_index(drop=True)


def _number_best(axes: Axes, scores: pandas.DataFrame) -> None:
    """Number the best features beside their points; neighbours share a label."""
    chosen = best(scores)
    places = chosen[SCORES].to_numpy(dtype=float)
    cluster = np.ones(len(chosen))
    if len(chosen) > 1:
        cluster = hierarchy.fcluster(hierarchy.linkage(places), NEAR_PERCENT, "distance")
    members = [np.flatnonzero(cluster == number) for number in np.unique(cluster)]
    names = [", ".join(str(member + 1) for member in some) for some in members]
    to_points = axes.transData + axes.get_figure().dpi_scale_trans.inverted() + Affine2D().scale(72)
    middles = np.array([places[some].mean(axis=0) for some in members])
    sizes = np.array([(LETTER * len(name), style.FONT_POINTS) for name in names])
    frame = to_points.transform(np.transpose([axes.get_xlim(), axes.get_ylim()])).ravel()
    placed = place_labels(to_points.transform(middles), sizes, _obstacles(chosen, scores, to_points, frame), frame)
    for name, place in zip(names, to_points.inverted().transform(placed), strict=True):
        axes.text(
            *place,
            name,
            ha="center",
            va="center",
            zorder=4,
            path_effects=[patheffects.withStroke(linewidth=1.5, foreground="white")],
        )


def _obstacles(
    chosen: pandas.DataFrame, scores: pandas.DataFrame, to_points: Transform, frame: np.ndarray
) -> list[tuple[float, ...]]:
    """Boxes, in points, of what is drawn: features, intervals of the best ones, and the lines of the means."""
    centres = to_points.transform(scores[SCORES].to_numpy(dtype=float))
    boxes = [(x - POINT / 2, y - POINT / 2, x + POINT / 2, y + POINT / 2) for x, y in centres]
    x, y = to_points.transform(scores[SCORES].mean().to_numpy())
    boxes += [(x - 0.5, frame[1], x + 0.5, frame[3]), (frame[0], y - 0.5, frame[2], y + 0.5)]
    if set(INTERVAL) <= set(chosen):
        for low, high, height in chosen[[*INTERVAL, SCORES[1]]].dropna().to_numpy(dtype=float):
            (x, y), (right, _) = to_points.transform([(low, height), (high, height)])
            boxes.append((x, y - 1.5, right, y + 1.5))
    return boxes


def _name_best(axes: Axes, scores: pandas.DataFrame, noise: Mapping[str, float | None] | None) -> None:
    """Name the best features under the panel, and draw the intervals of their stability."""
    chosen = best(scores)
    places = chosen[SCORES].to_numpy(dtype=float)
    if set(INTERVAL) <= set(chosen):
        reach = np.abs(chosen[INTERVAL].to_numpy(dtype=float).T - places[:, 0])
        axes.errorbar(*places.T, xerr=reach, fmt="none", ecolor=style.GREY, elinewidth=0.8, capsize=1.5, zorder=1)
    interval = ", and 95 % interval\nof the stability" if set(INTERVAL) <= set(chosen) else ""
    heading = f"Larger markers: several features.\nBest by the sum of both scores{interval}:"
    if noise:
        words = style.noise_levels(noise)
        heading = f"{words[0].upper()}{words[1:]}.\n{heading}"
    names = "\n".join(f"{index}  {_named(row)}" for index, (_, row) in enumerate(chosen.iterrows(), 1))
    for text, line in ((heading, 0), (names, heading.count("\n") + 1)):
        axes.annotate(
            text,
            (0, 0),
            xycoords="axes fraction",
            xytext=(0, -32 - line * LINE * style.FONT_POINTS),
            textcoords="offset points",
            ha="left",
            va="top",
            linespacing=1.25,
        )


def _named(row: pandas.Series) -> str:
    """A feature with the interval of its stability, where there is one."""
    low, high = (row.get(end, np.nan) for end in INTERVAL)
    interval = "" if np.isnan(low) else f", {low:.0f} to {high:.0f} %"
    return style.feature_label(row["feature"]) + interval
