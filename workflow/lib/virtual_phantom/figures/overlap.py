"""Overlap of the best features in simulation and measurement (figure 5 of Flouris et al., Sci. Rep. 2022)."""

import pandas
from matplotlib.figure import Figure

from . import style, tables

COLUMNS = ("overlap_{}_percent", "expected_{}_percent", "lower_{}_percent", "upper_{}_percent")
PANELS = {"stability": ("Stability", style.BLUE), "discrimination": ("Discriminative power", style.VERMILLION)}


@style.styled(grid=True)
def draw(table: pandas.DataFrame) -> Figure:
    """Overlap of the two lists' heads against their length, with what unrelated lists would give; a panel per kind.

    Parameters
    ----------
    table : DataFrame
        Columns n_top, percent, and for stability and discrimination overlap_{kind}_percent, overlap_{kind}_sd (drawn
        where it is known), expected_{kind}_percent, lower_{kind}_percent, upper_{kind}_percent (the 95 % band).

    Raises
    ------
    InputError
        If columns or rows lack.
    """
    numbers = [column.format(kind) for kind in PANELS for column in COLUMNS]
    tables.check_table(table, "overlap table", numbers=["n_top", "percent", *numbers])
    table = table.sort_values("percent")
    figure = style.figure(style.DOUBLE_COLUMN_MM, 92)
    percent = table["percent"]
    panels = figure.subplots(1, 2, sharey=True)
    for index, (axes, (kind, (title, colour))) in enumerate(zip(panels, PANELS.items(), strict=True)):
        overlap, expected, lower, upper = (table[column.format(kind)] for column in COLUMNS)
        for bottom, top, grey, label in (
            (0, lower, "#EEEEEE", "below the band: fewer in both lists than by chance"),
            (lower, upper, "#CCCCCC", "unrelated lists of features as correlated as these, 95 % band"),
        ):
            axes.fill_between(percent, bottom, top, color=grey, linewidth=0, label=label)
        axes.plot(percent, expected, color=style.GREY, linestyle=":", label="unrelated lists, expectation")
        axes.errorbar(
            percent,
            overlap,
            yerr=table[f"overlap_{kind}_sd"].fillna(0),
            errorevery=max(1, len(table) // 20),
            color=colour,
            elinewidth=0.8,
            label="best features in both lists; bars: SD over draws of measured scans",
        )
        axes.set(xlim=(0, 100), ylim=(0, 103), xlabel="features taken as best-scoring (%)", title=title)
        style.letter_panel(axes, index)
    panels[0].set_ylabel("of these, in both lists (%)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2)
    return figure
