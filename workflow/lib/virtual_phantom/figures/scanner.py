"""Residuals of the recordings of a scanner, without and with the physics found on its other recordings."""

from __future__ import annotations

from collections.abc import Mapping

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
    rms = [
        next(value for key, value in recording.items() if key.startswith("rms_")) for recording in recordings.values()
    ]
    figure = style.figure(style.DOUBLE_COLUMN_MM, REST_MM + ROW_MM * len(recordings))
    axes = figure.subplots()
    for (kind, color), key in zip(COLORS.items(), ("before", "after", "floor"), strict=True):
        axes.scatter([one[key] for one in rms], range(len(rms)), 25, color, linewidth=0, zorder=3, label=kind)
    axes.set_yticks(range(len(rms)), recordings)
    axes.set(xscale="log", ylim=(len(rms) - 0.5, -0.5), xlabel="RMS of recorded − modeled, held-out data", ylabel="")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(style.number_formatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=len(COLORS))
    return figure
