"""Overlap of the best features in simulation and measurement (figure 5 of Flouris et al., Sci. Rep. 2022)."""

import pandas
from matplotlib.figure import Figure

from . import style, tables


@style.styled()
def draw(table: pandas.DataFrame) -> Figure:
    """Overlap of the two lists' heads against their length, with what uncorrelated lists would give.

    table: n_top, percent, overlap_stability_percent, overlap_discrimination_percent, expected_percent,
    lower_percent, upper_percent (the 95 % band). Raises InputError if columns or rows lack.
    """
    tables.check_table(
        table,
        "overlap table",
        numbers=[
            "n_top",
            "percent",
            "overlap_stability_percent",
            "overlap_discrimination_percent",
            "expected_percent",
            "lower_percent",
            "upper_percent",
        ],
    )
    table = table.sort_values("percent")
    figure = style.figure(style.SINGLE_COLUMN_MM, 92)
    axes = figure.subplots()
    percent = table["percent"]
    lower, upper = table["lower_percent"], table["upper_percent"]
    for bottom, top, colour, label in (
        (0, lower, "#EEEEEE", "below the band: fewer in both lists than by chance"),
        (lower, upper, "#CCCCCC", "uncorrelated lists, 95 % band"),
    ):
        axes.fill_between(percent, bottom, top, color=colour, linewidth=0, label=label)
    axes.plot(
        percent,
        table["expected_percent"],
        color=style.GREY,
        linestyle=":",
        label="uncorrelated lists, expectation",
    )
    spacing = max(1, len(table) // 20)
    axes.plot(
        percent,
        table["overlap_stability_percent"],
        color=style.BLUE,
        marker="o",
        markevery=spacing,
        label="stability",
    )
    axes.plot(
        percent,
        table["overlap_discrimination_percent"],
        color=style.VERMILLION,
        linestyle="--",
        marker="s",
        markerfacecolor="white",
        markevery=(spacing // 2, spacing),
        label="discriminative power",
    )
    axes.set(
        xlim=(0, 100),
        ylim=(0, 103),
        xlabel="features taken as best-scoring (%)",
        ylabel="of these, in both lists (%)",
    )
    figure.legend(loc="outside lower left")
    return figure
