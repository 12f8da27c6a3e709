"""Ranking of further recordings by their expected information."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from . import style

ROW_MM, REST_MM = 4.5, 24.0  # height of the bar of a recording, and of axis and title
LONGEST = 60  # characters of the label of a recording
LEAST_SHOWN = 0.1  # log score: start of the logarithmic axis


@style.styled()
def draw_ranking(table: pd.DataFrame, enough: float) -> Figure:
    """Draw the expected information gain of every further recording, and how well it discriminates effects.

    Parameters
    ----------
    table : pandas.DataFrame
        Table of `diagnosis.planning.tables.ranking_table`; the row "now" is for the present data alone.
    enough : float
        Two effects are distinguished if their expected log scores differ by at least this.
    """
    ranked = table[table["name"] != "now"]
    labels = [text if len(text) <= LONGEST else text[: LONGEST - 1] + "…" for text in ranked["recording"]]
    scored = table["least_log_score"].notna().any()
    figure = style.figure(style.DOUBLE_COLUMN_MM, REST_MM + ROW_MM * len(ranked))
    left, *right = figure.subplots(1, 2 if scored else 1, sharey=True, squeeze=False)[0]
    style.bars(left, labels, ranked["information_gain_nats"], style.BLUE)
    left.set(xlabel="expected information gain (nats)", ylabel="")
    for axes in right:
        scores = np.maximum(ranked["least_log_score"].to_numpy(float), LEAST_SHOWN)
        style.bars(axes, labels, scores, style.ORANGE)
        axes.set(xscale="log", xlabel="smallest log score between two effects", ylabel="", xlim=(LEAST_SHOWN, None))
        axes.xaxis.set_major_locator(LogLocator())
        axes.xaxis.set_major_formatter(style.number_formatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.axvline(enough, color=style.GREY, linestyle="--", linewidth=0.8, label=f"distinguished: {enough:g}")
        now = max(float(table.loc[table["name"] == "now", "least_log_score"].iloc[0]), LEAST_SHOWN)
        axes.axvline(now, color=style.GREY, linestyle=":", linewidth=0.8, label="now")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=2)
    return figure
