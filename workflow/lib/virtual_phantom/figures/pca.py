"""Principal components of simulated and measured features (figures 6 to 8 of Flouris et al., Sci. Rep. 2022)."""

from collections.abc import Mapping

import pandas
import seaborn
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from . import style, tables

MOST_NAMED = 14  # values of a parameter in the legend (two lines); of more values, every second or third is shown
FEW_MEASURED = 100  # measured points that are drawn on top; more are drawn below the simulated ones, with their means
SIMULATED_POINTS, MEASURED_POINTS, MEAN_POINTS = 3.4, 4.5, 8.0  # diameters of markers
LEGEND_SCALE = 1.4
LEGEND_COLUMNS = 5
WHITE_HALO = [patheffects.withStroke(linewidth=2.4, foreground="white")]


@style.styled(grid=True)
def draw(table: pandas.DataFrame, title: str | None = None) -> Figure:
    """Draw two panels of the same points, a marker per ROI, colored by number of projections and by noise level.

    Measured rows are hollow markers on top of the simulated ones. If there are more than FEW_MEASURED, they are drawn
    below, with larger markers for the means of the ROIs on top.

    Parameters
    ----------
    table : DataFrame
        Columns source (simulated | measured), projections, noise_level, seed, roi, pc1, pc2, explained_pc1_percent,
        explained_pc2_percent. The optional column condition (such as the scanner) colors the measured rows.

    Raises
    ------
    InputError
        If columns or simulated rows are missing, a source is unknown, or the explained variances differ.
    """
    name = "PCA table"
    tables.check_table(
        table,
        name,
        text=["source", "projections", "noise_level", "seed", "roi"],
        numbers=["pc1", "pc2", "explained_pc1_percent", "explained_pc2_percent"],
    )
    explained = table[["explained_pc1_percent", "explained_pc2_percent"]].drop_duplicates()
    if len(explained) > 1:
        raise InputError(f"{name}: explained variances differ between rows; draw one PCA at a time")
    first, second = explained.iloc[0]
    unknown = sorted(set(table["source"]) - {"simulated", "measured"})
    if unknown:
        raise InputError(f"{name}: source {', '.join(map(str, unknown))} is neither simulated nor measured")
    measured = table[table["source"] == "measured"]
    # sorted by seed, so that no value of a parameter is always on top
    simulated = table[table["source"] == "simulated"].sort_values("seed", kind="stable")
    tables.check_table(simulated, f"{name}, simulated rows", numbers=["projections", "noise_level"])
    markers = style.assign([*simulated["roi"], *measured["roi"]], style.MARKERS)

    conditions = _conditions(measured)
    legend_rows = -(-(len(markers) + 3 + len(conditions)) // LEGEND_COLUMNS)
    figure = style.figure(style.DOUBLE_COLUMN_MM, 88 + 4 * legend_rows)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    factor, factor_text = style.power_of_ten(simulated["noise_level"])
    simulated = simulated.assign(noise_level=simulated["noise_level"] / factor)
    shown = {"projections": "number of projections", "noise_level": f"noise level A = 1/I₀ ({factor_text})"}
    for index, (axes, (column, parameter)) in enumerate(zip(panels, shown.items(), strict=True)):
        palette = style.ordered_colors(simulated[column])
        filled = {"hue": column, "palette": palette, "edgecolor": "white", "linewidth": 0.2, "zorder": 2}
        _scatter(axes, simulated, markers, SIMULATED_POINTS, **filled)
        handles, _ = axes.get_legend_handles_labels()
        every = slice(None, None, -(-len(palette) // MOST_NAMED))
        names = [style.number(value) for value in palette][every]
        place = {"title": parameter, "loc": "lower center", "bbox_to_anchor": (0.5, 1), "ncols": MOST_NAMED // 2}
        tight = {"columnspacing": 1, "handlelength": 1, "handletextpad": 0.2, "markerscale": LEGEND_SCALE}
        axes.legend(handles[1 : 1 + len(palette)][every], names, **place, **tight)
        _measured(axes, measured, markers, conditions)
        style.letter_panel(axes, index)
        axes.set(xlabel=f"PC 1 ({first:.1f} % of variance)", ylabel=None)
    panels[0].set_ylabel(f"PC 2 ({second:.1f} % of variance)")
    if title:
        figure.suptitle(title)
    legend = [*zip(handles[2 + len(palette) :], map(style.label, markers), strict=True)]
    legend.append((handles[1 + len(palette) // 2], "color: simulated"))
    hollow = {"linestyle": "none", "marker": "o", "color": "black", "markerfacecolor": "none"}
    if len(measured):
        legend.append((Line2D([], [], **hollow), "hollow: measured" if conditions else "black: measured"))
    legend += [(Line2D([], [], **hollow | {"color": color}), name) for name, color in conditions.items()]
    if len(measured) > FEW_MEASURED:
        large = {"markersize": MEAN_POINTS / LEGEND_SCALE, "markeredgewidth": 1.2}
        legend.append((Line2D([], [], **large, **hollow), "large: mean of measured"))
    columns = min(LEGEND_COLUMNS, len(legend))
    figure.legend(*zip(*legend, strict=True), markerscale=LEGEND_SCALE, loc="outside lower center", ncols=columns)
    return figure


def _scatter(axes: Axes, rows: pandas.DataFrame, markers: Mapping[str, str], points: float, **look) -> None:
    """Draw a marker for every row, with the shape of its ROI and a diameter of `points`."""
    shapes = {"style": "roi", "style_order": list(markers), "markers": dict(markers)}
    sizes = {roi: style.marker_area(marker, points) for roi, marker in markers.items()}
    seaborn.scatterplot(rows, x="pc1", y="pc2", size="roi", sizes=sizes, ax=axes, **shapes, **look)


def _conditions(measured: pandas.DataFrame) -> dict[str, str]:
    """Return {condition: color} of the measured rows; empty if they name no conditions."""
    if "condition" not in measured:
        return {}
    names = sorted(measured["condition"].dropna().astype(str).unique())
    return dict(zip(names, seaborn.color_palette("husl", len(names)).as_hex(), strict=True))


def _measured(axes: Axes, rows: pandas.DataFrame, markers: Mapping[str, str], conditions: Mapping[str, str]) -> None:
    """Draw hollow markers, black or colored by condition."""
    for name, color in conditions.items():
        colored = {"facecolor": "none", "edgecolor": color, "legend": False, "linewidth": 1.1, "zorder": 3}
        _scatter(axes, rows[rows["condition"] == name], markers, MEASURED_POINTS, **colored)
    if conditions:
        return
    hollow = {"facecolor": "none", "edgecolor": "black", "legend": False}
    if len(rows) > FEW_MEASURED:
        _scatter(axes, rows, markers, SIMULATED_POINTS, linewidth=0.4, zorder=1, **hollow)
        means = rows.groupby("roi", as_index=False)[["pc1", "pc2"]].mean()
        _scatter(axes, means, markers, MEAN_POINTS, linewidth=1.2, zorder=4, path_effects=WHITE_HALO, **hollow)
    elif len(rows):
        _scatter(axes, rows, markers, MEASURED_POINTS, linewidth=0.7, zorder=3, **hollow)
