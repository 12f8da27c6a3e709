"""What each property of the simulated images explains of the features that miss a recording."""

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from . import style, tables

ROW_MM = 5.0
DARK = 0.6  # of a colour map's range: letters on it are white
TEXT = ["family", "variant"]
NUMBERS = ["misses", "cells"]


@style.styled()
def draw(table: pandas.DataFrame, title: str | None = None) -> Figure:
    """Two heat maps, one row per variant (best first) and one column per family.

    table   `Attribution.properties` of `statistics.attribution`
    Left the share of misses repaired, right the median share of the distance removed; both in per cent. A family
    without misses is empty. Raises InputError if columns lack or the table is empty.
    """
    tables.check_table(
        table, "attribution table", text=[*TEXT, "share_repaired", "median_removed_share"], numbers=NUMBERS
    )
    families = list(dict.fromkeys(table["family"]))
    variants = list(table[table["family"] == families[0]].sort_values("rank")["variant"])
    wide = {
        column: table.pivot(index="variant", columns="family", values=column).loc[variants, families].to_numpy(float)
        for column in ("share_repaired", "median_removed_share")
    }
    counts = table.drop_duplicates("family").set_index("family").loc[families]
    figure = style.figure(style.DOUBLE_COLUMN_MM, ROW_MM * len(variants) + 38 + (5 if title else 0))
    left, right = figure.subplots(1, 2, sharey=True)
    _map(left, wide["share_repaired"], "Blues", 0, 1)
    _map(right, wide["median_removed_share"], "RdBu", -1, 1)
    for index, (axes, name) in enumerate(((left, "misses repaired (%)"), (right, "distance removed, median (%)"))):
        axes.set_xticks(range(len(families)))
        labels = [
            f"{family}\n{row.misses} of {row.cells}" for family, row in zip(families, counts.itertuples(), strict=True)
        ]
        axes.set_xticklabels(labels, rotation=60, ha="right", rotation_mode="anchor")
        axes.set_xlabel(name)
        style.letter_panel(axes, index)
    left.set_yticks(range(len(variants)), [style.label(name) for name in variants])
    if title:
        figure.suptitle(title)
    return figure


def _map(axes: Axes, values: np.ndarray, colours: str, low: float, high: float) -> None:
    image = axes.imshow(np.clip(values, low, high), cmap=colours, vmin=low, vmax=high, aspect="auto")
    for row, column in np.ndindex(values.shape):
        value = values[row, column]
        if np.isfinite(value):
            strength = abs(np.clip(value, low, high)) / high
            text = style.number(max(-999.0, round(100 * value)))
            axes.text(column, row, text, ha="center", va="center", color="white" if strength > DARK else "black")
    image.cmap.set_bad("#EEEEEE")
