"""What effects change of a recording, and how alike their templates are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas
import seaborn
from matplotlib.figure import Figure

from . import style

ACROSS, PANEL_MM, TITLE_MM = 4, 30.0, 8.0
MOST_SHOWN = 99.5  # percentile of |values| that has the full colour: single pixels at edges would hide the rest
WRITTEN = 0.05  # |correlation| from which a cell has its value written


@dataclass(frozen=True)
class Panel:
    """What a part of the data shows of one template.

    Attributes
    ----------
    values : ndarray, shape (views, x) or (x,)
        Standard deviations: a map, or bars with `names`.
    across : str
        What x is, and of which part.
    names : tuple of str
        Of the bars.
    """

    title: str
    values: np.ndarray
    across: str
    names: tuple[str, ...] = ()


@style.styled()
def draw_templates(panels: Sequence[Panel]) -> Figure:
    """Small multiples, each on its own scale: the number in its corner has the full colour, or is the longest bar."""
    down = -(-len(panels) // ACROSS)
    figure = style.figure(style.DOUBLE_COLUMN_MM, TITLE_MM + PANEL_MM * down)
    axes = figure.subplots(down, ACROSS).ravel()
    for place, panel in zip(axes, panels, strict=False):
        sizes = np.abs(panel.values)
        limit = float(sizes.max() if panel.names else np.percentile(sizes, MOST_SHOWN)) or 1.0
        if panel.names:
            seaborn.barplot(x=panel.names, y=panel.values, color=style.BLUE, saturation=1, width=0.7, ax=place)
            place.axhline(0, color=style.GREY, linewidth=0.6)
            place.margins(y=0.3)
            place.tick_params(length=0)
        else:
            place.imshow(panel.values, aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
            place.set_xticks([])
        place.set_yticks([])
        place.set_title(panel.title, loc="left", fontsize=style.FONT_POINTS)
        place.set_xlabel(panel.across, labelpad=2)
        place.set_ylabel("SD" if panel.names else "view", labelpad=2)
        place.text(
            0.97,
            0.95,
            style.number(limit) if panel.names else f"±{style.number(limit)}",
            transform=place.transAxes,
            ha="right",
            va="top",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )
    for place in axes[len(panels) :]:
        place.set_axis_off()
    return figure


@style.styled()
def draw_correlations(correlation: np.ndarray, labels: Sequence[str]) -> Figure:
    """Heat map of cosines between templates, in hundredths where they are not next to 0.

    Parameters
    ----------
    correlation : ndarray, shape (templates, templates)
    """
    values = pandas.DataFrame(correlation, labels, labels)
    words = values.fillna(0).map(lambda value: style.number(round(100 * value)) if abs(value) >= WRITTEN else "")
    figure = style.figure(style.DOUBLE_COLUMN_MM, style.DOUBLE_COLUMN_MM * 1.08)
    axes = figure.subplots()
    shown = style.heat_map(axes, values, words, cmap="RdBu_r", vmin=-1, vmax=1, square=True)
    text = "correlation of templates, alignment projected out"
    figure.colorbar(shown, ax=axes, location="top", label=text, shrink=0.6, aspect=40)
    return figure
