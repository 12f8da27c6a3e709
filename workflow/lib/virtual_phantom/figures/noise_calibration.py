"""Image noise against the noise level A = 1/I0 (figure 3 of Flouris et al., Sci. Rep. 2022)."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from ..statistics.noise import EVERY_ROI, LinearFit, linear_fit
from . import style, tables

MEASURED_LINES = ("--", "-.", ":", (0, (6, 2, 1, 2, 1, 2)))
LEGEND_CHARACTERS = 61  # a line of the legend in a single column


def crossing(line: LinearFit, variance_hu2: float) -> float | None:
    """The A at which a fit reaches a variance (HU^2); None if it does so at no positive A."""
    try:
        return line.noise_level_for(variance_hu2)
    except InputError:
        return None


@style.styled(grid=True)
def draw(
    table: pandas.DataFrame,
    study_levels: Mapping[str, float] | None = None,
    measured: Sequence[tuple[str, float]] = (),
    roi: str = EVERY_ROI,
) -> Figure:
    """Variance against A for each protocol with its fit, and where the fits cross measured variances.

    Parameters
    ----------
    table : DataFrame
        Columns protocol, noise_level, roi, variance_hu2, standard_error (HU^2).
    study_levels : mapping of str to float, optional
        A of the noise levels that the study itself uses, by label.
    measured : sequence of tuple, optional
        (label, variance in HU^2) of measured scans.
    roi : str, optional
        Whose rows are drawn.

    Raises
    ------
    InputError
        If columns or rows lack, or a protocol has fewer than two noise levels.
    """
    name, numbers = "noise calibration table", ["noise_level", "variance_hu2", "standard_error"]
    tables.check_table(table, name, text=["protocol", "roi"])
    rows = table[table["roi"] == roi].sort_values("noise_level", kind="stable")
    tables.check_table(rows, f"{name}, ROI {roi}", numbers=numbers)
    factor, unit = style.power_of_ten(rows["noise_level"])  # levels are in it from here on
    series = dict(list(rows.assign(noise_level=rows["noise_level"] / factor).groupby("protocol")))
    fits = {protocol: linear_fit(group["noise_level"], group["variance_hu2"]) for protocol, group in series.items()}
    studied = {label: level / factor for label, level in (study_levels or {}).items()}
    crossings = [{protocol: crossing(line, variance) for protocol, line in fits.items()} for _, variance in measured]
    reached = [level for levels in crossings for level in levels.values() if level is not None]
    furthest = max([*(group["noise_level"].max() for group in series.values()), *studied.values(), *reached])
    colours, markers = style.assign(series, style.ON_WHITE), style.assign(series, style.MARKERS)

    figure = style.figure(style.SINGLE_COLUMN_MM, 62)
    axes = figure.subplots()
    handles = []
    for protocol, group in series.items():
        look = {"color": colours[protocol], "marker": markers[protocol]}
        handles += [
            _points(axes, protocol, group, look),
            _line(axes, group, fits[protocol], furthest, unit, look["color"]),
        ]
    for (label, variance), levels, pattern in zip(measured, crossings, itertools.cycle(MEASURED_LINES), strict=False):
        text = _mark(axes, levels, variance, pattern, colours, unit)
        text = textwrap.fill(f"measured {label}: {style.number(variance)} HU², {text}", LEGEND_CHARACTERS)
        handles.append(axes.axhline(variance, color="black", linewidth=0.9, linestyle=pattern, label=text))
    if studied:
        handles.append(_study(axes, studied, unit))
    axes.set(
        xlabel=f"noise level A = 1/I₀ ({unit})",
        ylabel="variance over repeats, all ROIs (HU²)",
        xlim=(0, 1.05 * furthest),
    )
    axes.set_ylim(bottom=0)
    lines = sum(1 + handle.get_label().count("\n") for handle in handles)
    figure.set_figheight((62 + 3.8 * lines) / style.MILLIMETRES_PER_INCH)
    figure.legend(handles=handles, loc="outside lower left")
    return figure


def describe(line: LinearFit, unit: str) -> str:
    """The fit in words; A is in `unit`."""
    sign = "−" if line.intercept < 0 else "+"
    return (
        f"fit: {style.number(line.slope)} HU² · A/{unit} {sign} {style.number(abs(line.intercept))} HU², "
        f"R² = {line.r_squared:.4f}"
    )


def _points(axes: Axes, protocol: str, group: pandas.DataFrame, look: Mapping[str, str]) -> ErrorbarContainer:
    return axes.errorbar(
        group["noise_level"],
        group["variance_hu2"],
        yerr=group["standard_error"],
        linestyle="none",
        markeredgecolor="white",
        markeredgewidth=0.4,
        capsize=2,
        elinewidth=0.8,
        zorder=3,
        label=f"{style.label(protocol)}: simulated, ± standard error",
        **look,
    )


def _line(axes: Axes, group: pandas.DataFrame, fit: LinearFit, furthest: float, unit: str, colour: str) -> Line2D:
    """The fit; dotted beyond the simulated levels, where it is a guess."""
    first, last = group["noise_level"].min(), group["noise_level"].max()
    within, beyond = (fit.intercept + fit.slope * np.array(ends) for ends in ((first, last), (last, furthest)))
    axes.plot([last, furthest], beyond, color=colour, linewidth=0.8, linestyle=(0, (1, 1.5)))
    return axes.plot([first, last], within, color=colour, label=describe(fit, unit))[0]


def _mark(axes: Axes, levels: Mapping[str, float | None], variance: float, pattern, colours, unit: str) -> str:
    """Mark where the fits reach a variance, and say it."""
    known = {protocol: level for protocol, level in levels.items() if level is not None}
    for protocol, level in known.items():
        axes.vlines(level, 0, variance, color=colours[protocol], linewidth=0.8, linestyle=pattern)
        axes.plot(
            level, variance, "o", markersize=5, markerfacecolor="none", markeredgecolor=colours[protocol], zorder=4
        )
    numbers = ["–" if level is None else style.number(level) for level in levels.values()]
    return f"met at A = {', '.join(numbers)} ×{unit}" if known else "not met"


def _study(axes: Axes, levels: Mapping[str, float], unit: str) -> Line2D:
    names = ", ".join(f"{style.number(level)} ×{unit} ({style.label(label)})" for label, level in levels.items())
    (handle,) = axes.plot(
        list(levels.values()),
        np.zeros(len(levels)),
        linestyle="none",
        marker="^",
        color="black",
        markersize=6,
        clip_on=False,
        zorder=5,
        transform=axes.get_xaxis_transform(),
        label=textwrap.fill(f"level of the study: A = {names}", LEGEND_CHARACTERS),
    )
    return handle
