"""What each property of the simulated images explains of the features that miss a recording."""

import pandas
from matplotlib.figure import Figure

from . import style, tables

ROW_MM = 5.0
# Column, what it is, its colours, and the value in per cent with which they begin
PANELS = (
    ("share_repaired", "misses repaired (%)", "Blues", 0),
    ("median_removed_share", "distance removed, median (%)", "RdBu", -100),
)


@style.styled()
def draw(table: pandas.DataFrame, title: str | None = None) -> Figure:
    """Two heat maps, one row per variant (best first) and one column per family.

    Left the share of misses repaired, right the median share of the distance removed; both in per cent. A family
    without misses is empty.

    Parameters
    ----------
    table : DataFrame
        `Attribution.properties` of `statistics.attribution`.

    Raises
    ------
    InputError
        If columns lack or the table is empty.
    """
    columns = ["family", "variant", *(column for column, *_ in PANELS)]
    tables.check_table(table, "attribution table", text=columns, numbers=["misses", "cells"])
    families = list(dict.fromkeys(table["family"]))
    variants = list(table[table["family"] == families[0]].sort_values("rank")["variant"])
    counts = table.drop_duplicates("family").set_index("family").loc[families]
    named = [
        f"{family}\n{row.misses} of {row.cells}" for family, row in zip(families, counts.itertuples(), strict=True)
    ]
    figure = style.figure(style.DOUBLE_COLUMN_MM, ROW_MM * len(variants) + 42 + (5 if title else 0))
    for index, (axes, (column, text, colours, least)) in enumerate(
        zip(figure.subplots(1, 2, sharey=True), PANELS, strict=True)
    ):
        percent = 100 * table.pivot(index="variant", columns="family", values=column).loc[variants, families]
        percent = percent.set_axis(map(style.label, variants)).set_axis(named, axis="columns")
        # without + 0.0 some would be −0
        words = (percent.fillna(0).round() + 0.0).clip(lower=-999).map(style.number)
        style.heat_map(axes, percent, words, cmap=colours, vmin=least, vmax=100)
        axes.set_xlabel(text)
        style.letter_panel(axes, index)
    figure.supxlabel("below each family: how many of its cells (feature and ROI) miss the recording", fontsize="medium")
    if title:
        figure.suptitle(title)
    return figure
