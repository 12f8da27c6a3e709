"""Further recordings by what they are expected to tell."""

from __future__ import annotations

import numpy as np
import pandas as pd
import seaborn
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from . import style

ROW_MM, REST_MM = 4.5, 24.0  # height of a recording, and of axis and title
LONGEST = 60  # letters of what is to be done
LEAST_SHOWN = 0.1  # log score: less is nothing on a logarithmic axis


@style.styled()
def draw_ranking(table: pd.DataFrame, enough: float) -> Figure:
    """The gain of information of every further recording, and the log score by which it parts effects.

    Parameters
    ----------
    table : pandas.DataFrame
        As diagnosis.next_written.table gives it.
    enough : float
        Log score from which effects are told apart.
    """
    ranked = table[table["name"] != "now"]
    words = [text if len(text) <= LONGEST else text[: LONGEST - 1] + "…" for text in ranked["recording"]]
    scored = table["least_log_score"].notna().any()
    figure = style.figure(style.DOUBLE_COLUMN_MM, REST_MM + ROW_MM * len(ranked))
    left, *right = figure.subplots(1, 2 if scored else 1, sharey=True, squeeze=False)[0]
    seaborn.barplot(x=ranked["information_gain_nats"].to_numpy(), y=words, color=style.BLUE, saturation=1, ax=left)
    left.set(xlabel="expected gain of information, nats", ylabel="")
    for axes in right:
        scores = np.maximum(ranked["least_log_score"].to_numpy(float), LEAST_SHOWN)
        seaborn.barplot(x=scores, y=words, color=style.ORANGE, saturation=1, ax=axes)
        axes.set(xscale="log", xlabel="least log score between two of them", ylabel="", xlim=(LEAST_SHOWN, None))
        axes.xaxis.set_major_locator(LogLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.axvline(enough, color=style.GREY, linestyle="--", linewidth=0.8, label=f"told apart: {enough:g}")
        now = max(float(table.loc[table["name"] == "now", "least_log_score"].iloc[0]), LEAST_SHOWN)
        axes.axvline(now, color=style.GREY, linestyle=":", linewidth=0.8, label="now")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=2)
    return figure
