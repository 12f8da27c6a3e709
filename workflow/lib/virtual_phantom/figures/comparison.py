"""Comparison of simulated with recorded features: all features and ROIs on one page."""

import matplotlib
import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from ..statistics.comparison import ALPHA
from ..statistics.comparison_summary import RANK_RIGHT
from . import style, tables

ROW_MM = 2.35  # smallest row for 7 point type; 86 rows fit a page of A4
LEAST_COLUMNS = 6  # smallest width of a panel, in columns, for its color scale
GAP_ROWS = 1.3  # gap between families, for their names
# Steps of the color scales, in margins. Values beyond the last step share a color: a shift of 300 SD is as wrong as a
# shift of 30 SD.
SHIFT_STEPS = (1, 3, 10, 30)
RATIO_STEPS = (1, 2, 3)  # log of the SD ratio over log of the margin: factors 2, 4 and 8
# Diverging maps that readers with common color vision deficiencies can read.
SHIFT_COLORS, RATIO_COLORS = "RdBu_r", "PuOr_r"
NEUTRAL, MISSING, IN_ORDER = "#FFFFFF", "#BBBBBB", "#AAD4BF"
DOT, RING = 1.5, 3.2  # diameters in points
# {column with the reason why a feature cannot be compared: (mark of the feature, begin of the note)}
MARKED = {"other_settings": ("*", "recording:"), "other_sizes": ("†", "grows with the ROI; recording:")}


@style.styled()
def draw(table: pandas.DataFrame, ranking: pandas.DataFrame, title: str | None = None) -> Figure:
    """Draw one row per feature, by family: shift of the mean, ratio of the SDs, and order of the ROIs.

    Cells within the margin are white, others have a stepped color, and cells without a number are gray. A dot marks a
    significant difference (false discovery rate), a ring an equivalence.

    Parameters
    ----------
    table : DataFrame
        From `statistics.comparison.compare`; ROIs are columns, in the table's order.
    ranking : DataFrame
        From `statistics.comparison_summary.ranks` or `summary`: feature, kendall_tau (not drawn if all are missing).
        Features with a text in the optional columns other_settings (features.settings) and other_sizes
        (`statistics.comparability.other_sizes`) are marked, and the text is shown above.

    Raises
    ------
    InputError
        If columns or rows are missing, or an ROI lacks a feature or has it twice.
    """
    name = "comparison table"
    numbers = ["margin_sd", "sd_factor"]
    text = ["roi", "feature", "family", "shift_sd", "sd_ratio", "q_mean", "q_sd", "mean_equivalent", "sd_equivalent"]
    tables.check_table(table, name, text=text, numbers=numbers)
    tables.check_table(ranking, "ranks of the comparison", text=["feature", "kendall_tau"])
    rois = list(dict.fromkeys(table["roi"]))
    features = table[["feature", "family"]].drop_duplicates().reset_index(drop=True)
    if len(table) != len(rois) * len(features) or table.duplicated(["roi", "feature"]).any():
        raise InputError(f"{name}: needs exactly one row for every ROI and feature; make the table again")
    if missing := sorted(set(features["feature"]) - set(ranking["feature"])):
        raise InputError(f"ranks of the comparison: {missing[0]} is missing; make the table again")
    features = features.sort_values("family", kind="stable", key=lambda column: column.map(_order(column)))
    y = _rows(features["family"])
    wide = {
        column: table.pivot(index="feature", columns="roi", values=column).loc[features["feature"], rois].to_numpy()
        for column in text[3:]
    }
    tau = ranking.set_index("feature")["kendall_tau"].loc[features["feature"]].to_numpy(dtype=float)
    margin, factor = table["margin_sd"].iloc[0], table["sd_factor"].iloc[0]

    marks, notes = _marked(ranking, features["feature"])
    lines = [*([title] if title else []), *notes]
    height = ROW_MM * (y[-1] + 1 + GAP_ROWS)
    figure = style.figure(style.DOUBLE_COLUMN_MM, height + 41 + (5 if lines else 0) + 3 * max(0, len(lines) - 1))
    columns = max(len(rois), LEAST_COLUMNS)
    ranked = np.isfinite(tau).any()
    widths = [columns, columns, *([1.4] if ranked else [])]
    left, right, *rank = figure.subplots(1, len(widths), sharey=True, gridspec_kw={"width_ratios": widths})
    shift_steps = margin * np.array(SHIFT_STEPS)
    shift, ratio = wide["shift_sd"].astype(float), wide["sd_ratio"].astype(float)
    labels = [style.number(step) for step in (*-shift_steps[::-1], *shift_steps)]
    text = "shift of the mean (repeat SDs of the recording)"
    _heat(figure, left, y, shift, shift_steps, SHIFT_COLORS, labels, text)
    with np.errstate(divide="ignore"):
        logarithm = np.log2(ratio)
    ratio_steps = np.log2(factor) * np.array(RATIO_STEPS)
    labels = [_fraction(factor**step) for step in (*(-step for step in RATIO_STEPS[::-1]), *RATIO_STEPS)]
    _heat(figure, right, y, logarithm, ratio_steps, RATIO_COLORS, labels, "SD over repeats, simulated / recorded")
    for axes, kind, dark in (
        (left, "mean", np.abs(shift) > shift_steps[-2]),
        (right, "sd", np.abs(logarithm) > ratio_steps[-2]),
    ):
        _marks(axes, y, wide[f"q_{kind}"].astype(float) < ALPHA, wide[f"{kind}_equivalent"].astype(bool), dark)
    for index, axes in enumerate((left, right)):
        names = [style.label(roi) for roi in rois]
        axes.set_xticks(range(len(rois)), names, rotation=40, ha="right", rotation_mode="anchor")
        style.letter_panel(axes, index)
    if ranked:
        _rank_column(rank[0], y, tau)
    left.set_yticks(y, [_short(name) + marks.get(name, "") for name in features["feature"]])
    left.set_ylim(y[-1] + 0.5, -0.5 - GAP_ROWS)
    for family, rows in pandas.Series(y).groupby(features["family"].to_numpy(), sort=False):
        left.annotate(
            _family(family),
            (0, rows.min() - 0.5),
            xycoords=("axes fraction", "data"),
            xytext=(-3, 1),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontweight="bold",
            annotation_clip=False,
        )
    ring = {"marker": "o", "color": "black", "markersize": 3.5, "markerfacecolor": "none", "markeredgewidth": 0.7}
    legend = {
        f"differs (q < {ALPHA:g}); white on dark cells": {"marker": "o", "color": "black", "markersize": 2.5},
        "equivalent": ring,
        "constant: no ratio": {"marker": "s", "color": MISSING},
    }
    if ranked:
        legend[f"τ ≥ {RANK_RIGHT:g}: ROIs in order"] = {"marker": "s", "color": IN_ORDER}
    handles = [Line2D([], [], linestyle="none", label=text, **look) for text, look in legend.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    if lines:
        figure.suptitle("\n".join(lines))
    return figure


def _marked(ranking: pandas.DataFrame, features: pandas.Series) -> tuple[dict[str, str], list[str]]:
    """Return {feature: marks}, and the notes that explain the marks."""
    marks: dict[str, str] = {}
    notes = []
    for column, (mark, begin) in MARKED.items():
        if column not in ranking:
            continue
        texts = ranking.set_index("feature")[column].reindex(features).dropna()
        texts = texts[texts != ""]
        marks |= {feature: f"{marks.get(feature, '')} {mark}" for feature in texts.index}
        reasons = dict.fromkeys(reason for text in texts for reason in text.split("; "))
        notes += [f"{mark} {begin} {reason}" for reason in reasons]
    return marks, notes


def _order(families: pandas.Series) -> dict[str, int]:
    """Sort keys of families: first order first, then in order of appearance."""
    distinct = list(dict.fromkeys(families))
    return {family: -1 if family == "first order" else index for index, family in enumerate(distinct)}


def _rows(families: pandas.Series) -> np.ndarray:
    """Return the position of every row, from the top, with a gap between families."""
    changes = families.ne(families.shift()).cumsum() - 1
    return np.arange(len(families)) + GAP_ROWS * changes.to_numpy()


def _family(family: str) -> str:
    return "First order" if family == "first order" else style.family_label(family)


def _short(feature: str) -> str:
    image, _, rest = str(feature).partition("_")
    name = rest.partition("_")[2]
    return (name if image == "original" else f"{image} {name}") if name else str(feature)


def _fraction(value: float) -> str:
    return f"1/{style.number(1 / value)}" if value < 1 else style.number(value)


def _heat(figure: Figure, axes: Axes, y, values, steps, colors: str, labels: list[str], text: str) -> None:
    """Draw cells in steps of a diverging color map that is white around zero."""
    boundaries = np.array([*-steps[::-1], *steps])
    shades = matplotlib.colormaps[colors](np.linspace(0, 1, 2 * len(steps) + 1))
    shades[len(steps)] = to_rgba(NEUTRAL)
    color_map = ListedColormap(shades[1:-1]).with_extremes(under=shades[0], over=shades[-1], bad=MISSING)
    norm = BoundaryNorm(boundaries, color_map.N)
    masked = np.ma.masked_invalid(np.where(np.isposinf(values), 1e300, np.where(np.isneginf(values), -1e300, values)))
    for rows in np.split(np.arange(len(y)), np.flatnonzero(np.diff(y) > 1 + GAP_ROWS / 2) + 1):
        edges = np.arange(values.shape[1] + 1) - 0.5, np.append(y[rows] - 0.5, y[rows[-1]] + 0.5)
        axes.pcolormesh(*edges, masked[rows], cmap=color_map, norm=norm, edgecolors="#DDDDDD", linewidth=0.3)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    look = {"location": "top", "extend": "both", "spacing": "uniform", "aspect": 28, "pad": 0.005}
    bar = figure.colorbar(ScalarMappable(norm, color_map), ax=axes, **look)
    bar.set_ticks(boundaries, labels=labels)
    bar.ax.tick_params(length=0)
    bar.set_label(text)


def _marks(axes: Axes, y: np.ndarray, differs: np.ndarray, agrees: np.ndarray, dark: np.ndarray) -> None:
    """Draw dots (white on `dark` cells) and rings."""
    for chosen, look in (
        (differs & ~dark, {"s": DOT**2, "color": "black", "linewidths": 0}),
        (differs & dark, {"s": DOT**2, "color": "white", "linewidths": 0}),
        (agrees, {"s": RING**2, "facecolors": "none", "edgecolors": "black", "linewidths": 0.6}),
    ):
        rows, columns = np.nonzero(chosen)
        axes.scatter(columns, y[rows], marker="o", zorder=3, **look)


def _rank_column(axes: Axes, y: np.ndarray, tau: np.ndarray) -> None:
    """Write Kendall's tau, in a green cell where the order of the ROIs agrees."""
    for row, value in zip(y, tau, strict=True):
        if np.isfinite(value) and value >= RANK_RIGHT:
            axes.fill_between([-0.5, 0.5], row - 0.5, row + 0.5, color=IN_ORDER, linewidth=0)
        text = "–" if np.isnan(value) else f"{value:.2f}".replace("-", "−")
        axes.text(0.38, row, text, ha="right", va="center")
    axes.set_xlim(-0.5, 0.5)
    axes.set_xticks([])
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.set_title("order,\nτ", fontsize=style.FONT_POINTS)
