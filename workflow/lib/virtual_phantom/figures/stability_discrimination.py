"""Stability and discriminative power of every feature (figure 4 of Flouris et al., Sci. Rep. 2022)."""

from collections.abc import Mapping

import numpy as np
import pandas
import seaborn
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.cluster import hierarchy

from ..base.errors import InputError
from ..statistics.ranking import KINDS
from ..statistics.repeats import mean_over_features
from . import style, tables
from .labels import POINT, label_points, marker_boxes, to_points

SCORES = [f"{kind}_percent" for kind in KINDS]
INTERVAL = ["ci95_low", "ci95_high"]
BEST = 5  # features named in each panel
NEAR_PERCENT = 4.0  # best features at smaller distances share a label
LINE = 1.45  # line spacing, relative to the font size
ROUND_PERCENT, EDGE_PERCENT = 20, 4  # axes end EDGE_PERCENT beyond a multiple of ROUND_PERCENT


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
    """Draw one point per feature, by family, and a second panel with measured scores of the same features, if given.

    Features of one family with equal scores share a marker, whose area is their number. The BEST features by the sum of
    both scores are numbered, and named below the panel.

    Parameters
    ----------
    table : DataFrame
        Columns feature, family, stability_percent, discrimination_percent.
    threshold : float
        Pairs of groups are stable if |W| is below this value, and pairs of classes are discriminated if it is above.
    measured : DataFrame, optional
        Scores from `statistics.repeats.score_draws`. The figure shows means over draws, and the SD over draws of the
        mean over features.
    repeats : int, optional
        Repeats per group of `table`, for the title.
    sd : tuple of float, optional
        SDs of the means over features of both scores of `table`, if known.
    intervals : DataFrame, optional
        Columns feature, ci95_low, ci95_high of the stability of `table`, for the numbered features.
    noise : mapping of str to float or None, optional
        {noise level: A} of `table`, for the text.

    Raises
    ------
    InputError
        If columns or rows are missing, a score is not a number, or the tables share no feature.
    """
    tables.check_table(table, "stability table", text=["feature", "family"], numbers=SCORES)
    if intervals is not None:
        # With one repeat per group there are no intervals.
        table = table.merge(intervals[["feature", *INTERVAL]].dropna(), on="feature", how="left")
    shown = {"Simulated": (table, repeats, sd)}
    if measured is not None:
        tables.check_table(measured, "measured scores", text=["feature"], numbers=["draw", "repeats", "of", *SCORES])
        measured = measured.drop(columns="family", errors="ignore").merge(table[["feature", "family"]], on="feature")
        if measured.empty:
            raise InputError("measured scores: share no feature with the stability table; use names of pyradiomics")
        sds = tuple(mean_over_features(measured, kind)[1] for kind in KINDS)
        means = measured.groupby(["feature", "family"], sort=False)[SCORES].mean().reset_index()
        shown["Measured"] = (means, int(measured["repeats"].iloc[0]), sds if np.isfinite(sds).all() else None)
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
        per_group = f", {repeats} repeats per group" if repeats else ""
        texts = [f"{mean:.1f}" for mean in (stability, discrimination)]
        if sd is not None:
            texts = [f"{mean} ± {error:.1f}" for mean, error in zip(texts, sd, strict=True)]
        means = f"means: {texts[0]} % stable, {texts[1]} % discriminated"
        axes.set_title(f"{title}, {len(scores)} features{per_group}\n{means}")
        if double:
            style.letter_panel(axes, index)
        axes.set(ylabel=None)
        axes.set_xlabel(f"stability: pairs of groups with |W| < {threshold:g} (%)")
    _limit(panels, [scores for scores, *_ in shown.values()])
    panels[0].set_ylabel(f"discriminative power: pairs across classes with |W| > {threshold:g} (%)")
    handles, _ = panels[0].get_legend_handles_labels()  # a heading, the families, and seaborn's entries for sizes
    handles = [*handles[1 : 1 + len(families)], dashed]
    named = [*map(style.family_label, families), "mean of the features"]
    figure.legend(handles, named, loc="outside upper center", ncols=6 if double else 3, markerscale=1.4)
    figure.draw_without_rendering()  # fixes the layout, on which the placement of numbers depends
    for axes, (scores, *_) in zip(panels, shown.values(), strict=True):
        _number_best(axes, scores)
    return figure


def _scatter(axes: Axes, scores: pandas.DataFrame, families: list[str]) -> None:
    """Draw one marker per family and pair of scores, with an area for the number of features, largest first."""
    markers = style.assign(families, style.MARKERS)
    points = scores.groupby(["family", *SCORES]).size().reset_index(name="count")
    points = points.sort_values("count", ascending=False, kind="stable")
    points["area"] = points["count"] * [style.marker_area(markers[family], POINT) for family in points["family"]]
    areas = {area: area for area in points["area"]}
    look = {"size": "area", "sizes": areas, **style.by_family(families)}
    seaborn.scatterplot(points, x=SCORES[0], y=SCORES[1], ax=axes, zorder=2, **look)
    axes.get_legend().remove()


def _limit(panels: np.ndarray, scores: list[pandas.DataFrame]) -> None:
    """Set the same limits in all panels, for all points and intervals."""
    x, y = (pandas.concat([table[kind] for table in scores]) for kind in SCORES)
    ends = pandas.concat([x, *(table[INTERVAL[1]].dropna() for table in scores if INTERVAL[1] in table)])
    right = ROUND_PERCENT * max(1, np.ceil(ends.max() / ROUND_PERCENT))
    low = ROUND_PERCENT * min(4, np.floor(y.min() / ROUND_PERCENT))
    for axes in panels:
        axes.set(xlim=(-EDGE_PERCENT, right + EDGE_PERCENT), ylim=(low - EDGE_PERCENT, 100 + EDGE_PERCENT))


def best(scores: pandas.DataFrame) -> pandas.DataFrame:
    """Return the BEST rows by the sum of both scores, best first; ties are in order of names."""
    both = scores.assign(both=scores[SCORES].sum(axis=1))
    return both.sort_values(["both", "feature"], ascending=[False, True]).head(BEST).reset_index(drop=True)


def _number_best(axes: Axes, scores: pandas.DataFrame) -> None:
    """Number the best features next to their points; near features share a label."""
    chosen = best(scores)
    positions = chosen[SCORES].to_numpy(dtype=float)
    cluster = np.ones(len(chosen))
    if len(chosen) > 1:
        cluster = hierarchy.fcluster(hierarchy.linkage(positions), NEAR_PERCENT, "distance")
    members = [np.flatnonzero(cluster == number) for number in np.unique(cluster)]
    names = [", ".join(str(member + 1) for member in group) for group in members]
    centers = np.array([positions[group].mean(axis=0) for group in members])
    label_points(axes, names, centers, _obstacles(axes, chosen, scores))


def _obstacles(axes: Axes, chosen: pandas.DataFrame, scores: pandas.DataFrame) -> list[tuple[float, ...]]:
    """Return boxes, in points, around the features, the intervals of the best features, and the lines of the means."""
    transform = to_points(axes)
    boxes = marker_boxes(axes, scores[SCORES].to_numpy(dtype=float))
    left, bottom, right, top = transform.transform(np.transpose([axes.get_xlim(), axes.get_ylim()])).ravel()
    x, y = transform.transform(scores[SCORES].mean().to_numpy())
    boxes += [(x - 0.5, bottom, x + 0.5, top), (left, y - 0.5, right, y + 0.5)]
    if set(INTERVAL) <= set(chosen):
        for low, high, height in chosen[[*INTERVAL, SCORES[1]]].dropna().to_numpy(dtype=float):
            (x_low, y), (x_high, _) = transform.transform([(low, height), (high, height)])
            boxes.append((x_low, y - 1.5, x_high, y + 1.5))
    return boxes


def _name_best(axes: Axes, scores: pandas.DataFrame, noise: Mapping[str, float | None] | None) -> None:
    """Name the best features below the panel, and draw the intervals of their stability."""
    chosen = best(scores)
    interval = ""
    if set(INTERVAL) <= set(chosen):
        interval = ", with 95 % interval\nof the stability"
        positions = chosen[SCORES].to_numpy(dtype=float)
        error = np.abs(chosen[INTERVAL].to_numpy(dtype=float).T - positions[:, 0])
        axes.errorbar(*positions.T, xerr=error, fmt="none", ecolor=style.GREY, elinewidth=0.8, capsize=1.5, zorder=1)
    heading = f"Larger markers: several features.\nBest by the sum of both scores{interval}:"
    if noise:
        heading = f"{style.noise_sentence(noise)}\n{heading}"
    names = "\n".join(f"{index}  {_named(row)}" for index, (_, row) in enumerate(chosen.iterrows(), 1))
    for text, line in ((heading, 0), (names, heading.count("\n") + 1)):
        below = {"xytext": (0, -32 - line * LINE * style.FONT_POINTS), "textcoords": "offset points"}
        axes.annotate(text, (0, 0), xycoords="axes fraction", ha="left", va="top", linespacing=1.25, **below)


def _named(row: pandas.Series) -> str:
    """Return a feature's label with the interval of its stability, if known."""
    low, high = (row.get(end, np.nan) for end in INTERVAL)
    interval = "" if np.isnan(low) else f", {low:.0f} to {high:.0f} %"
    return style.feature_label(row["feature"]) + interval
