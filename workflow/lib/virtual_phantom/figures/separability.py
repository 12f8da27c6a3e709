"""Templates of effects, and the correlations between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas
import seaborn
from matplotlib.figure import Figure

from . import style

ACROSS, PANEL_MM, TITLE_MM = 4, 30.0, 8.0
MOST_SHOWN = 99.5  # percentile of |values| with the full color: single pixels at edges would hide the others
WRITTEN = 0.05  # |correlation| from which a cell shows its number


@dataclass(frozen=True)
class Panel:
    """Template of one effect in one part of the data.

    Attributes
    ----------
    values : ndarray, shape (views, x) or (x,)
        Values in standard deviations: a map, or bars if there are `names`.
    across : str
        Label of x, with the part of the data.
    names : tuple of str
        Names of the bars.
    """

    title: str
    values: np.ndarray
    across: str
    names: tuple[str, ...] = ()


@style.styled()
def draw_templates(panels: Sequence[Panel]) -> Figure:
    """Draw each template on its own scale. The number in the corner has the full color, or is the longest bar."""
    down = -(-len(panels) // ACROSS)
    figure = style.figure(style.DOUBLE_COLUMN_MM, TITLE_MM + PANEL_MM * down)
    axes = figure.subplots(down, ACROSS).ravel()
    for ax, panel in zip(axes, panels, strict=False):
        sizes = np.abs(panel.values)
        limit = float(sizes.max() if panel.names else np.percentile(sizes, MOST_SHOWN)) or 1.0
        if panel.names:
            seaborn.barplot(x=panel.names, y=panel.values, color=style.BLUE, saturation=1, width=0.7, ax=ax)
            ax.axhline(0, color=style.GREY, linewidth=0.6)
            ax.margins(y=0.3)
            ax.tick_params(length=0)
        else:
            ax.imshow(panel.values, aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
            ax.set_xticks([])
        ax.set_yticks([])
        ax.set_title(panel.title, loc="left", fontsize=style.FONT_POINTS)
        ax.set_xlabel(panel.across, labelpad=2)
        ax.set_ylabel("SD" if panel.names else "view", labelpad=2)
        ax.text(
            0.97,
            0.95,
            style.number(limit) if panel.names else f"±{style.number(limit)}",
            transform=ax.transAxes,
            ha="right",
            va="top",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    return figure


@style.styled()
def draw_correlations(correlation: np.ndarray, labels: Sequence[str]) -> Figure:
    """Draw a heat map of the correlations between templates, with numbers in hundredths from WRITTEN.

    Parameters
    ----------
    correlation : ndarray, shape (templates, templates)
    """
    values = pandas.DataFrame(correlation, labels, labels)
    numbers = values.fillna(0).map(lambda value: style.number(round(100 * value)) if abs(value) >= WRITTEN else "")
    figure = style.figure(style.DOUBLE_COLUMN_MM, style.DOUBLE_COLUMN_MM * 1.08)
    axes = figure.subplots()
    image = style.heat_map(axes, values, numbers, cmap="RdBu_r", vmin=-1, vmax=1, square=True)
    text = "correlation of templates after projection of the alignment"
    figure.colorbar(image, ax=axes, location="top", label=text, shrink=0.6, aspect=40)
    return figure
