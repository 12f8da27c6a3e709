"""Overlap of the best features in simulation and measurement (figure 5 of Flouris et al., Sci. Rep. 2022)."""

import pandas
from matplotlib.figure import Figure

from . import style, tables

COLUMNS = ("overlap_{}_percent", "expected_{}_percent", "lower_{}_percent", "upper_{}_percent")
PANELS = {"stability": ("Stability", style.BLUE), "discrimination": ("Discriminative power", style.VERMILLION)}


@style.styled(grid=True)
def draw(table: pandas.DataFrame) -> Figure:
    """Draw the overlap of the best features against their number, with the 95 % band of random lists.

    Parameters
    ----------
    table : DataFrame
        From `statistics.ranking.overlap`.

    Raises
    ------
    InputError
        If columns or rows are missing.
    """
    numbers = [column.format(kind) for kind in PANELS for column in COLUMNS]
    tables.check_table(table, "overlap table", numbers=["n_top", "percent", *numbers])
    table = table.sort_values("percent")
    figure = style.figure(style.DOUBLE_COLUMN_MM, 92)
    percent = table["percent"]
    panels = figure.subplots(1, 2, sharey=True)
    for index, (axes, (kind, (title, color))) in enumerate(zip(panels, PANELS.items(), strict=True)):
        overlap, expected, lower, upper = (table[column.format(kind)] for column in COLUMNS)
        for bottom, top, gray, label in (
            (0, lower, "#EEEEEE", "below the band: less overlap than by chance"),
            (lower, upper, "#CCCCCC", "random lists of equally correlated features, 95 % band"),
        ):
            axes.fill_between(percent, bottom, top, color=gray, linewidth=0, label=label)
        axes.plot(percent, expected, color=style.GREY, linestyle=":", label="random lists, mean")
        bars = {
            "yerr": table[f"overlap_{kind}_sd"].fillna(0),
            "errorevery": max(1, len(table) // 20),
            "elinewidth": 0.8,
        }
        text = "simulated and measured lists; bars: SD of random samples"
        axes.errorbar(percent, overlap, color=color, label=text, **bars)
        axes.set(xlim=(0, 100), ylim=(0, 103), xlabel="length of both lists (% of the features)", title=title)
        style.letter_panel(axes, index)
    panels[0].set_ylabel("features in both lists (% of the length)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2)
    return figure
