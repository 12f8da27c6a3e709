"""A diagnosis of features in pictures: shifts by family and region, and what every property removes."""

from __future__ import annotations

import pandas
from matplotlib.figure import Figure

from . import style, tables
from .diagnosis import bars

STRONG_SD = 10.0  # colours end there
ROW_MM = 6.0


@style.styled()
def draw_shifts(before: pandas.DataFrame, after: pandas.DataFrame | None = None) -> Figure:
    """Median |shift| of every family in every ROI, in repeat SDs, as heat maps on one scale.

    Parameters
    ----------
    before, after : DataFrame
        From `statistics.comparison.compare`. Without `after` there is one map.

    Raises
    ------
    InputError
        If a table is empty or lacks roi, family or shift_sd.
    """
    wide = []
    for table, name in ((before, "comparison before"), (after, "comparison after")):
        if table is None:
            continue
        tables.check_table(table, name, text=["roi", "family"], numbers=["shift_sd"])
        medians = table.assign(size=table["shift_sd"].abs()).groupby(["family", "roi"], sort=False)["size"].median()
        wide.append(medians.unstack(sort=False))
    figure = style.figure(style.DOUBLE_COLUMN_MM, ROW_MM * len(wide[0]) + 34)
    axes = figure.subplots(1, 2, sharey=True)  # of the same width, with one map too
    names = ("as simulated", "with the property found, regions not fitted")
    for index, (place, values, name) in enumerate(zip(axes, wide, names, strict=False)):
        words = values.round(1).map(style.number)
        shown = style.heat_map(place, values.rename(columns=style.label), words, cmap="Blues", vmin=0, vmax=STRONG_SD)
        place.set_title(name)
        style.letter_panel(place, index)
    for place in axes[len(wide) :]:
        place.set_axis_off()
    figure.colorbar(shown, ax=axes, label="median |shift| (repeat SDs)", extend="max", shrink=0.9)
    return figure


@style.styled(grid=True)
def draw_shares(
    fitted: dict[str, float], held_out: dict[str, float], chosen: tuple[str, ...], material: float
) -> Figure:
    """Share of the difference beyond noise that every property alone removes, in their order.

    Parameters
    ----------
    fitted, held_out : dict of str to float
        By property: of regions that were fitted, and that were not.
    chosen : tuple of str
        Those of the verdict.
    material : float
        Share from which a property counts.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 20 + ROW_MM * len(held_out))
    axes = figure.subplots()
    bars(axes, {name: 100 * share for name, share in held_out.items()}, chosen)
    axes.plot([100 * fitted[name] for name in held_out], range(len(held_out)), "|", color="black", markersize=9)
    axes.axvline(100 * material, color=style.GREY, linewidth=0.8, linestyle="--")
    axes.set_xlabel(
        "difference removed on regions not fitted (%), each property alone; blue: in the verdict\n"
        "bars across: on the regions fitted; dashed: the least that counts"
    )
    return figure
