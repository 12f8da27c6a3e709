"""Stability and discriminative power of every feature (figure 4 of Flouris et al., Sci. Rep. 2022)."""

import textwrap
from collections.abc import Mapping

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.cluster import hierarchy

from ..base.errors import InputError
from ..statistics import controls as control_rows
from ..statistics.ranking import KINDS
from ..statistics.repeats import mean_over_features
from . import style, tables
from .labels import POINT, label_points, marker_boxes, to_points

SCORES = [f"{kind}_percent" for kind in KINDS]
INTERVAL = ["ci95_low", "ci95_high"]
BEST = 5  # numbered features of each source
NEAR_POINTS = 7.0  # numbered features at smaller distances (1/72 inch) share a label
LINEAR_PERCENT = 2.0  # the axis of stability is logarithmic above
STABILITY_TICKS = (0, 2, 5, 10, 20, 50, 100)
STABILITY_LIMITS = -0.3, 118.0  # percent
ROUND_PERCENT, EDGE_PERCENT = 20, 4  # the axis of discrimination ends EDGE_PERCENT beyond a multiple of ROUND_PERCENT
TITLE_CHARACTERS = 54  # per line of a title
PANEL_MM = 92.0  # height of a panel with legend, title and axis


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
    controls: pandas.DataFrame | None = None,
) -> Figure:
    """Draw one point per feature, by family, and a second panel with measured scores of the same features, if given.

    Features of one family with equal scores share a marker, whose area is their number. The BEST features of each
    panel by the sum of both scores have the same number in both panels and are listed below. Without discriminative
    power, as for a single ROI, the points are drawn by family.

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
    controls : DataFrame, optional
        From `statistics.controls.controls` of `table`, for titles and lines.

    Raises
    ------
    InputError
        If columns or rows are missing, a score is not a number, or the tables share no feature.
    """
    discriminates = SCORES[1] not in table or table[SCORES[1]].notna().any()
    scored = SCORES if discriminates else SCORES[:1]
    tables.check_table(table, "stability table", text=["feature", "family"], numbers=scored)
    if intervals is not None:
        # With one repeat per group there are no intervals.
        table = table.merge(intervals[["feature", *INTERVAL]].dropna(), on="feature", how="left")
    shown = {"Simulated": (table, repeats, sd)}
    if measured is not None and discriminates:
        tables.check_table(measured, "measured scores", text=["feature"], numbers=["draw", "repeats", "of", *SCORES])
        measured = measured.drop(columns="family", errors="ignore").merge(table[["feature", "family"]], on="feature")
        if measured.empty:
            raise InputError("measured scores: share no feature with the stability table; use names of pyradiomics")
        sds = tuple(mean_over_features(measured, kind)[1] for kind in KINDS)
        means = measured.groupby(["feature", "family"], sort=False)[SCORES].mean().reset_index()
        shown["Measured"] = (means, int(measured["repeats"].iloc[0]), sds if np.isfinite(sds).all() else None)
    families = sorted(set(table["family"]))
    numbered = list(dict.fromkeys(name for scores, *_ in shown.values() for name in best(scores)))

    double = len(shown) > 1
    width_mm = style.DOUBLE_COLUMN_MM if double else style.SINGLE_COLUMN_MM
    figure = style.figure(width_mm, PANEL_MM + style.LINE_MM * (len(numbered) + 3))
    panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
    titles = _titles(shown, controls if discriminates else None, scored)
    for index, (axes, (name, (scores, *_))) in enumerate(zip(panels, shown.items(), strict=True)):
        placed = scores if discriminates else scores.assign(**{SCORES[1]: scores["family"].map(families.index)})
        shown[name] = placed, *shown[name][1:]
        entries = _scatter(axes, placed, families)
        _intervals(axes, placed, numbered)
        dashed = axes.axvline(scores[SCORES[0]].mean(), color=style.GREY, linestyle="--", linewidth=0.9, zorder=1)
        dashed.set_label("mean of the features")
        if discriminates:
            axes.axhline(scores[SCORES[1]].mean(), color=style.GREY, linestyle="--", linewidth=0.9, zorder=1)
        if double:
            style.letter_panel(axes, index, titles[name])
        else:
            axes.set_title(titles[name], loc="left")
        axes.set_xscale("symlog", linthresh=LINEAR_PERCENT, linscale=0.5)
        axes.set_xticks(STABILITY_TICKS, map(str, STABILITY_TICKS))
        axes.set_xticks([], minor=True)
        axes.set(xlim=STABILITY_LIMITS, ylabel=None)
        axes.set_xlabel(f"stability: pairs of groups with |W| < {threshold:g} (%)")
    if discriminates:
        lowest = min(scores[SCORES[1]].min() for scores, *_ in shown.values())
        low = ROUND_PERCENT * min(4, np.floor(lowest / ROUND_PERCENT))
        panels[0].set_ylim(low - EDGE_PERCENT, 100 + EDGE_PERCENT)
        panels[0].set_ylabel(f"discriminative power: pairs across classes with |W| > {threshold:g} (%)")
    else:
        panels[0].set_yticks(range(len(families)), map(style.family_label, families))
        panels[0].set_ylim(len(families) - 0.5, -0.5)
    handles = [*entries, dashed] if discriminates else [dashed]
    figure.legend(handles=handles, loc="outside upper center", ncols=6 if double else 3, markerscale=1.4)
    _list(figure, shown, numbered, scored, noise)
    figure.draw_without_rendering()  # fixes the layout, on which the placement of numbers depends
    for axes, (scores, *_) in zip(panels, shown.values(), strict=True):
        _number(axes, scores, numbered)
    return figure


def best(scores: pandas.DataFrame) -> list[str]:
    """Return the BEST features by the sum of both scores, best first; ties are in order of names."""
    both = scores.assign(both=scores[SCORES].sum(axis=1))
    return list(both.sort_values(["both", "feature"], ascending=[False, True])["feature"].head(BEST))


def _titles(shown: Mapping, controls: pandas.DataFrame | None, scored: list[str]) -> dict[str, str]:
    """Return the titles of the panels: what is shown, and the mean scores with their controls."""
    titles = {}
    for name, (scores, repeats, sd) in shown.items():
        kinds = KINDS[: len(scored)]
        means = pandas.DataFrame({"score": kinds, "percent": [scores[column].mean() for column in scored]})
        rows = means.assign(control=[control_rows.PROTOCOLS, control_rows.DIFFERENT_CLASSES][: len(scored)])
        if controls is not None:
            chance = controls["control"] == control_rows.CHANCE  # depends on the number of repeats
            own = ~controls["control"].isin(rows["control"])
            comparable = repeats == shown["Simulated"][1]
            rows = pandas.concat([rows, controls[own if name == "Simulated" else own & chance & comparable]])
        words = control_rows.headline(rows, dict(zip(KINDS, sd, strict=True)) if sd else None)
        per_group = f", {repeats} repeats per group" if repeats else ""
        lines = [f"{name}: {len(scores)} features{per_group}"]
        for kind, adjective in zip(kinds, ("stable", "discriminated"), strict=False):
            lines += textwrap.wrap(f"{adjective}: {words[kind]}", TITLE_CHARACTERS)
        titles[name] = lines
    most = max(map(len, titles.values()))
    return {name: "\n".join([*lines, *[""] * (most - len(lines))]) for name, lines in titles.items()}


def _scatter(axes: Axes, scores: pandas.DataFrame, families: list[str]) -> list[Line2D]:
    """Draw one marker per family and pair of scores, with an area for the number of features, largest first.

    Returns
    -------
    list of Line2D
        Entries of a legend, one per family.
    """
    markers = style.assign(families, style.MARKERS)
    points = scores.groupby(["family", *SCORES]).size().reset_index(name="count")
    points = points.sort_values("count", ascending=False, kind="stable")
    points["area"] = points["count"] * [style.marker_area(markers[family], POINT) for family in points["family"]]
    return style.scatter_families(axes, points, *SCORES, families, s=points["area"])


def _intervals(axes: Axes, scores: pandas.DataFrame, numbered: list[str]) -> None:
    """Draw the intervals of the stability of the numbered features."""
    if not set(INTERVAL) <= set(scores):
        return
    chosen = scores[scores["feature"].isin(numbered)].dropna(subset=INTERVAL)
    positions = chosen[SCORES].to_numpy(dtype=float)
    error = np.abs(chosen[INTERVAL].to_numpy(dtype=float).T - positions[:, 0])
    axes.errorbar(*positions.T, xerr=error, fmt="none", ecolor=style.GREY, elinewidth=0.8, capsize=1.5, zorder=1)


def _number(axes: Axes, scores: pandas.DataFrame, numbered: list[str]) -> None:
    """Number features next to their points; near features share a label."""
    chosen = scores.set_index("feature")[SCORES].reindex(numbered)
    numbers, positions = np.flatnonzero(chosen.notna().all(axis=1)), chosen.dropna().to_numpy(dtype=float)
    transform = to_points(axes)
    places, cluster = transform.transform(positions), np.ones(len(positions))
    if len(positions) > 1:
        cluster = hierarchy.fcluster(hierarchy.linkage(places), NEAR_POINTS, "distance")
    members = [np.flatnonzero(cluster == number) for number in np.unique(cluster)]
    names = [", ".join(str(numbers[member] + 1) for member in group) for group in members]
    centers = transform.inverted().transform(np.array([places[group].mean(axis=0) for group in members]))
    label_points(axes, names, centers, _obstacles(axes, scores, numbered))


def _obstacles(axes: Axes, scores: pandas.DataFrame, numbered: list[str]) -> list[tuple[float, ...]]:
    """Return boxes, in points, around the features, the drawn intervals, and the lines of the means."""
    transform = to_points(axes)
    boxes = marker_boxes(axes, scores[SCORES].to_numpy(dtype=float))
    left, bottom, right, top = transform.transform(np.transpose([axes.get_xlim(), axes.get_ylim()])).ravel()
    x, y = transform.transform(scores[SCORES].mean().to_numpy())
    boxes += [(x - 0.5, bottom, x + 0.5, top), (left, y - 0.5, right, y + 0.5)]
    if set(INTERVAL) <= set(scores):
        chosen = scores[scores["feature"].isin(numbered)]
        for low, high, height in chosen[[*INTERVAL, SCORES[1]]].dropna().to_numpy(dtype=float):
            (x_low, y), (x_high, _) = transform.transform([(low, height), (high, height)])
            boxes.append((x_low, y - 1.5, x_high, y + 1.5))
    return boxes


def _list(
    figure: Figure, shown: Mapping, numbered: list[str], scored: list[str], noise: Mapping[str, float | None] | None
) -> None:
    """List the numbered features with their scores in all panels."""
    columns = [("", [str(index) for index in range(1, 1 + len(numbered))])]
    columns.append(("feature", [style.feature_label(name) for name in numbered]))
    for name, (scores, *_) in shown.items():
        rows, source = scores.set_index("feature").reindex(numbered), ""
        if len(shown) > 1:
            source = f"{name.lower()}: "
            columns.append((f"{source}stable", list(map(_percent, rows[SCORES[0]]))))
            columns.append(("discr.", list(map(_percent, rows[SCORES[1]]))))
        if set(INTERVAL) <= set(rows) and rows[INTERVAL].notna().any(axis=None):
            ends = rows[INTERVAL].to_numpy(float)
            ranges = ["–" if np.isnan(low) else f"{low:.0f} to {high:.0f} %" for low, high in ends]
            columns.insert(3 if source else 2, ("95 % CI", ranges))
    note = "Larger markers: features with equal scores."
    style.write_columns(figure, columns, note + (f"\n{style.noise_sentence(noise)}" if noise else ""))


def _percent(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.0f} %"
