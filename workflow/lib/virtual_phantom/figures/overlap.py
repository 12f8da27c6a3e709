"""Overlap of the best features in simulation and measurement (figure 5 of Flouris et al., Sci. Rep. 2022)."""

import pandas
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from . import style, tables

COLUMNS = ("overlap_{}_percent", "expected_{}_percent", "lower_{}_percent", "upper_{}_percent")
PANELS = {"stability": "Stability", "discrimination": "Discriminative power"}
AREAS = ("area_{}", "area_{}_expected", "area_{}_upper")
BAND = "chance: 95 % of random lists\nof equally correlated features"
BAND_COLOR, BELOW_COLOR = "#D2D2D2", "#F0F0F0"
BELOW = "less overlap\nthan by chance"


@style.styled(grid=True)
def draw(table: pandas.DataFrame) -> Figure:
    """Draw the overlap of the best features against their number, with the 95 % band of random lists.

    Parameters
    ----------
    table : DataFrame
        From `statistics.ranking.overlap`. Titles give the areas under the curves, if the table has them.

    Raises
    ------
    InputError
        If columns or rows are missing.
    """
    numbers = [column.format(kind) for kind in PANELS for column in COLUMNS]
    tables.check_table(table, "overlap table", numbers=["n_top", "percent", *numbers])
    table = table.sort_values("percent")
    figure = style.figure(style.DOUBLE_COLUMN_MM, 88)
    percent = table["percent"]
    panels = figure.subplots(1, 2, sharey=True)
    for index, (axes, (kind, title)) in enumerate(zip(panels, PANELS.items(), strict=True)):
        overlap, expected, lower, upper = (table[column.format(kind)] for column in COLUMNS)
        for bottom, top, gray in ((0, lower, BELOW_COLOR), (lower, upper, BAND_COLOR)):
            axes.fill_between(percent, bottom, top, color=gray, linewidth=0)
        axes.plot(percent, expected, color=style.GREY, linestyle=":", label="mean of random lists")
        bars = {
            "yerr": table[f"overlap_{kind}_sd"].fillna(0),
            "errorevery": max(1, len(table) // 20),
            "elinewidth": 0.8,
        }
        text = "overlap of simulated and measured lists; bars: SD over random samples of scans"
        axes.errorbar(percent, overlap, color=style.BLUE, label=text, **bars)
        axes.set(xlim=(0, 100), ylim=(0, 103), xlabel="length of both lists (% of the features)")
        _explain(axes, percent, expected, lower, upper)
        style.letter_panel(axes, index, "\n".join([title, *_areas(table, kind)]))
    panels[0].set_ylabel("features in both lists (% of the length)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2)
    return figure


def _explain(axes: Axes, percent: pandas.Series, *curves: pandas.Series) -> None:
    """Write what the band is where it is widest, on the wider side of its mean, and what lies below it."""
    expected, lower, upper = (curve.to_numpy() for curve in curves)
    above = (upper - expected).max() > (expected - lower).max()
    edge = upper if above else lower
    at = abs(edge - expected).argmax()
    x = min(max(percent.iloc[at], 30), 70)
    halo = [patheffects.withStroke(linewidth=2, foreground=BAND_COLOR)]
    axes.text(x, (edge[at] + expected[at]) / 2, BAND, ha="center", va="center", path_effects=halo)
    axes.text(98, 3, BELOW, ha="right", va="bottom")


def _areas(table: pandas.DataFrame, kind: str) -> list[str]:
    """Return a line with the area under the curve, and with the area for random lists, if known."""
    names = [name.format(kind) for name in AREAS]
    if not set(names) <= set(table):
        return []
    found, expected, upper = table[names].iloc[0]
    return [f"area {found:.2f} (by chance: {expected:.2f}, 97.5 % of lists < {upper:.2f})"]
