"""Figures of a diagnosis of features: shifts per family and region, and the difference that each property removes."""

from __future__ import annotations

import pandas
from matplotlib.figure import Figure

from . import style, tables
from .diagnosis import bars

STRONG_SD = 10.0  # end of the color scale
ROW_MM = 6.0


@style.styled()
def draw_shifts(before: pandas.DataFrame, after: pandas.DataFrame | None = None) -> Figure:
    """Draw heat maps of the median |shift| in repeat SDs for each family and ROI, on one color scale.

    Parameters
    ----------
    before, after : DataFrame
        Tables of `statistics.comparison.compare`. Without `after`, there is one map.

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
    axes = figure.subplots(1, 2, sharey=True)  # two panels even for one map, which keeps its width
    names = ("as simulated", "with the property found, held-out regions")
    for index, (panel, values, name) in enumerate(zip(axes, wide, names, strict=False)):
        numbers = values.round(1).map(style.number)
        image = style.heat_map(panel, values.rename(columns=style.label), numbers, cmap="Blues", vmin=0, vmax=STRONG_SD)
        panel.set_title(name)
        style.letter_panel(panel, index)
    for panel in axes[len(wide) :]:
        panel.set_axis_off()
    figure.colorbar(image, ax=axes, label="median |shift| (repeat SDs)", extend="max", shrink=0.9)
    return figure


@style.styled(grid=True)
def draw_shares(
    fitted: dict[str, float], held_out: dict[str, float], chosen: tuple[str, ...], material: float
) -> Figure:
    """Draw the share of the difference beyond noise that each property alone removes, in the given order.

    Parameters
    ----------
    fitted, held_out : dict of str to float
        {property: share}, on the fitted and on the held-out regions.
    chosen : tuple of str
        Properties in the verdict.
    material : float
        Smallest share that counts as an explanation.
    """
    figure = style.figure(style.DOUBLE_COLUMN_MM, 20 + ROW_MM * len(held_out))
    axes = figure.subplots()
    bars(axes, {name: 100 * share for name, share in held_out.items()}, chosen)
    axes.plot([100 * fitted[name] for name in held_out], range(len(held_out)), "|", color="black", markersize=9)
    axes.axvline(100 * material, color=style.GREY, linewidth=0.8, linestyle="--")
    axes.set_xlabel(
        "difference removed on held-out regions (%), each property alone; blue: in the verdict\n"
        "vertical marks: on fitted regions; dashed: smallest share that counts"
    )
    return figure
