"""Image noise as a function of the noise level A = 1/I0 (figure 3 of Flouris et al., Sci. Rep. 2022)."""

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
OVER_REPEATS, AMONG_VOXELS = "variance_hu2", "spatial_variance_hu2"  # columns of the table
LEGEND_CHARACTERS = 56  # characters per line of the legend


def crossing(line: LinearFit, variance_hu2: float) -> float | None:
    """Return the noise level A at which a fit reaches a variance (HU^2); None if A is not positive."""
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
    column: str = OVER_REPEATS,
) -> Figure:
    """Draw the variance against A for each protocol, with linear fits and their crossings with measured variances.

    Measured variances are those among the voxels of one ROI, so draw AMONG_VOXELS of that ROI with them.

    Parameters
    ----------
    table : DataFrame
        Columns protocol, noise_level, roi, `column`, and with OVER_REPEATS standard_error (HU^2).
    study_levels : mapping of str to float, optional
        {label: A} of the noise levels of the study.
    measured : sequence of tuple, optional
        (label, variance in HU^2) of measured scans.
    roi : str, optional
        ROI to draw.
    column : {"variance_hu2", "spatial_variance_hu2"}, optional
        OVER_REPEATS or AMONG_VOXELS.

    Raises
    ------
    InputError
        If columns or rows are missing, or a protocol has fewer than two noise levels.
    """
    name, numbers = "noise calibration table", ["noise_level", column]
    if column == OVER_REPEATS:
        numbers.append("standard_error")
    tables.check_table(table, name, text=["protocol", "roi"])
    rows = table[table["roi"] == roi].sort_values("noise_level", kind="stable")
    tables.check_table(rows, f"{name}, ROI {roi}", numbers=numbers)
    factor, unit = style.power_of_ten(rows["noise_level"])  # unit of all levels below
    series = dict(list(rows.assign(noise_level=rows["noise_level"] / factor).groupby("protocol")))
    fits = {protocol: linear_fit(group["noise_level"], group[column]) for protocol, group in series.items()}
    studied = {label: level / factor for label, level in (study_levels or {}).items()}
    crossings = [{protocol: crossing(line, variance) for protocol, line in fits.items()} for _, variance in measured]
    reached = [level for levels in crossings for level in levels.values() if level is not None]
    furthest = max([*(group["noise_level"].max() for group in series.values()), *studied.values(), *reached])
    colors, markers = style.assign(series, style.ON_WHITE), style.assign(series, style.MARKERS)

    figure = style.figure(style.SINGLE_COLUMN_MM, 62)
    axes = figure.subplots()
    handles = []
    for protocol, group in series.items():
        look = {"color": colors[protocol], "marker": markers[protocol]}
        handles += [
            _points(axes, protocol, group, column, look),
            _line(axes, group, fits[protocol], furthest, unit, look["color"]),
        ]
    for (label, variance), levels, pattern in zip(measured, crossings, itertools.cycle(MEASURED_LINES), strict=False):
        text = _mark(axes, levels, variance, pattern, colors, unit)
        text = textwrap.fill(f"measured {label}: {style.number(variance)} HU², {text}", LEGEND_CHARACTERS)
        handles.append(axes.axhline(variance, color="black", linewidth=0.9, linestyle=pattern, label=text))
    if studied:
        handles.append(_study(axes, studied, unit))
    kind = "over repeats" if column == OVER_REPEATS else "among voxels"
    axes.set(xlabel=f"noise level A = 1/I₀ ({unit})", ylabel=f"variance {kind}, {style.label(roi)} (HU²)")
    axes.set(xlim=(0, 1.05 * furthest), ylim=(0, None))
    lines = sum(1 + handle.get_label().count("\n") for handle in handles)
    figure.set_figheight((62 + 3.8 * lines) / style.MILLIMETRES_PER_INCH)
    figure.legend(handles=handles, loc="outside lower left")
    return figure


def describe(line: LinearFit, unit: str) -> str:
    """Describe a fit, with A in `unit`."""
    sign = "−" if line.intercept < 0 else "+"
    return (
        f"fit: {style.number(line.slope)} HU² · A/{unit} {sign} {style.number(abs(line.intercept))} HU², "
        f"R² = {line.r_squared:.4f}"
    )


def _points(
    axes: Axes, protocol: str, group: pandas.DataFrame, column: str, look: Mapping[str, str]
) -> ErrorbarContainer:
    errors = group["standard_error"] if column == OVER_REPEATS else None
    bars = {"yerr": errors, "linestyle": "none", "capsize": 2, "elinewidth": 0.8, "zorder": 3}
    edges = {"markeredgecolor": "white", "markeredgewidth": 0.4}
    text = f"{style.label(protocol)}: simulated{'' if errors is None else ', ± standard error'}"
    return axes.errorbar(group["noise_level"], group[column], label=text, **bars, **edges, **look)


def _line(axes: Axes, group: pandas.DataFrame, fit: LinearFit, furthest: float, unit: str, color: str) -> Line2D:
    """Draw a fit, dotted where it is extrapolated."""
    first, last = group["noise_level"].min(), group["noise_level"].max()
    within, beyond = (fit.intercept + fit.slope * np.array(ends) for ends in ((first, last), (last, furthest)))
    axes.plot([last, furthest], beyond, color=color, linewidth=0.8, linestyle=(0, (1, 1.5)))
    return axes.plot([first, last], within, color=color, label=describe(fit, unit))[0]


def _mark(axes: Axes, levels: Mapping[str, float | None], variance: float, pattern, colors, unit: str) -> str:
    """Mark the points where the fits reach a variance, and return the text of the legend."""
    known = {protocol: level for protocol, level in levels.items() if level is not None}
    for protocol, level in known.items():
        axes.vlines(level, 0, variance, color=colors[protocol], linewidth=0.8, linestyle=pattern)
        ring = {"markersize": 5, "markerfacecolor": "none", "markeredgecolor": colors[protocol]}
        axes.plot(level, variance, "o", zorder=4, **ring)
    numbers = ["–" if level is None else style.number(level) for level in levels.values()]
    return f"reached at A = {', '.join(numbers)} ×{unit}" if known else "not reached"


def _study(axes: Axes, levels: Mapping[str, float], unit: str) -> Line2D:
    names = ", ".join(f"{style.number(level)} ×{unit} ({style.label(label)})" for label, level in levels.items())
    look = {"linestyle": "none", "marker": "^", "color": "black", "markersize": 6, "clip_on": False, "zorder": 5}
    text = textwrap.fill(f"level of the study: A = {names}", LEGEND_CHARACTERS)
    at_bottom = axes.get_xaxis_transform()
    return axes.plot(list(levels.values()), np.zeros(len(levels)), transform=at_bottom, label=text, **look)[0]
