"""Residuals of the recordings of a scanner, without and with the physics found on its other recordings."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
import seaborn
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from . import style

COLORS = {"alignment only": style.VERMILLION, "physics of the other recordings": style.BLUE, "noise only": style.GREY}
ROW_MM, REST_MM = 6.0, 26.0  # height of the row of a recording, and of axis and legend


@style.styled()
def draw_recordings(recordings: Mapping[str, Mapping]) -> Figure:
    """Draw the RMS residual of every recording.

    Parameters
    ----------
    recordings : mapping of str to mapping
        Entry `recordings` of scanner.json.
    """
    rows = []
    for name, recording in recordings.items():
        rms = next(value for key, value in recording.items() if key.startswith("rms_"))
        for kind, key in zip(COLORS, ("before", "after", "floor"), strict=True):
            rows.append({"recording": name, "model": kind, "rms": rms[key]})
    figure = style.figure(style.DOUBLE_COLUMN_MM, REST_MM + ROW_MM * len(recordings))
    axes = figure.subplots()
    table = pd.DataFrame(rows)
    seaborn.stripplot(
        table, x="rms", y="recording", hue="model", palette=COLORS, jitter=False, size=5, log_scale=True, ax=axes
    )
    axes.set(xlabel="RMS of recorded − modeled, held-out data", ylabel="")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(style.number_formatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y")
    seaborn.move_legend(axes, "lower left", bbox_to_anchor=(0, 1), ncol=len(COLORS), title=None)
    return figure
