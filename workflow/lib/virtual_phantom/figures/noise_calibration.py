"""Image noise against the noise level A = 1/I0 (figure 3 of Flouris et al., Sci. Rep. 2022)."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.errors import InputError
from ..statistics.noise import LinearFit, linear_fit
from . import style, tables

MEASURED_LINES = ("--", "-.", ":", (0, (6, 2, 1, 2, 1, 2)))
LEGEND_CHARACTERS = 58  # a line of the legend in a single column


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
    roi: str = "all",
) -> Figure:
    """Variance against A for each protocol with its fit, and where the fits cross measured variances.

    table         protocol, noise_level, roi, variance_hu2, standard_error (HU^2); rows of `roi` are drawn
    study_levels  label -> A of the noise levels that the study itself uses
    measured      (label, variance in HU^2) of measured scans
    Raises InputError if columns or rows lack, or a protocol has fewer than two noise levels.
    """
    name, numbers = "noise calibration table", ["noise_level", "variance_hu2", "standard_error"]
    tables.check_table(table, name, text=["protocol", "roi"])
    rows = table[table["roi"] == roi].sort_values("noise_level", kind="stable")
    tables.check_table(rows, f"{name}, ROI {roi}", numbers=numbers)
    study_levels = dict(study_levels or {})
    series = dict(list(rows.groupby("protocol")))
    fits = {protocol: linear_fit(group["noise_level"], group["variance_hu2"]) for protocol, group in series.items()}
    crossings = {
        variance: {protocol: crossing(line, variance) for protocol, line in fits.items()} for _, variance in measured
    }
    reached = [level for levels in crossings.values() for level in levels.values() if level is not None]
    furthest = max([rows["noise_level"].max(), *study_levels.values(), *reached])
    factor, factor_text = style.power_of_ten(rows["noise_level"])
    colours = style.assign(series, style.ON_WHITE)
    markers = style.assign(series, style.MARKERS)

    figure = style.figure(style.SINGLE_COLUMN_MM, 62)
    axes = figure.subplots()
    handles = []
    for protocol, group in series.items():
        handles += _protocol(
            axes,
            protocol,
            group,
            fits[protocol],
            furthest,
            factor,
            colours[protocol],
            markers[protocol],
            factor_text,
        )
    for (label, variance), pattern in zip(measured, itertools.cycle(MEASURED_LINES), strict=False):
        handles.append(_measured(axes, label, variance, pattern, crossings[variance], colours, factor, factor_text))
    if study_levels:
        handles.append(_study(axes, study_levels, factor, factor_text))
    axes.set(
        xlabel=f"noise level A = 1/I₀ ({factor_text})",
        ylabel="variance (HU²)",
        xlim=(0, 1.05 * furthest / factor),
    )
    axes.set_ylim(bottom=0)
    lines = sum(1 + handle.get_label().count("\n") for handle in handles)
    figure.set_figheight((62 + 3.8 * lines) / style.MILLIMETRES_PER_INCH)
    figure.legend(handles=handles, loc="outside lower left")
    return figure


def describe(line: LinearFit, factor: float, factor_text: str) -> str:
    """The fit in words, A in units of `factor`."""
    sign = "−" if line.intercept < 0 else "+"
    return (
        f"fit: {style.number(line.slope * factor)} HU² · A/{factor_text} {sign} "
        f"{style.number(abs(line.intercept))} HU², R² = {line.r_squared:.4f}"
    )


def _protocol(
    axes: Axes,
    protocol: str,
    group: pandas.DataFrame,
    line: LinearFit,
    furthest: float,
    factor: float,
    colour: str,
    marker: str,
    factor_text: str,
) -> list:
    points = axes.errorbar(
        group["noise_level"] / factor,
        group["variance_hu2"],
        yerr=group["standard_error"],
        linestyle="none",
        marker=marker,
        color=colour,
        markeredgecolor="white",
        markeredgewidth=0.4,
        capsize=2,
        elinewidth=0.8,
        zorder=3,
        label=f"{style.label(protocol)}: simulated, ± standard error",
    )
    first, last = group["noise_level"].min(), group["noise_level"].max()
    simulated, beyond = np.array([first, last]), np.array([last, furthest])
    (within,) = axes.plot(
        simulated / factor,
        line.intercept + line.slope * simulated,
        color=colour,
        label=describe(line, factor, factor_text),
    )
    if furthest > last:  # beyond the simulated levels the line is a guess, and looks like one
        axes.plot(
            beyond / factor,
            line.intercept + line.slope * beyond,
            color=colour,
            linewidth=0.8,
            linestyle=(0, (1, 1.5)),
        )
    return [points, within]


def _measured(
    axes: Axes,
    label: str,
    variance: float,
    pattern,
    levels: Mapping[str, float | None],
    colours: Mapping[str, str],
    factor: float,
    factor_text: str,
):
    for protocol, level in levels.items():
        if level is not None:
            axes.vlines(level / factor, 0, variance, color=colours[protocol], linewidth=0.8, linestyle=pattern)
            axes.plot(
                level / factor,
                variance,
                marker="o",
                markersize=5,
                markerfacecolor="none",
                markeredgecolor=colours[protocol],
                zorder=4,
            )
    text = f"{label}: {style.number(variance)} HU², not crossed"
    if any(level is not None for level in levels.values()):
        numbers = ["–" if level is None else style.number(level / factor) for level in levels.values()]
        text = text.replace("not crossed", f"crossed at A = {', '.join(numbers)} ×{factor_text}")
    return axes.axhline(
        variance,
        color="black",
        linewidth=0.9,
        linestyle=pattern,
        label=textwrap.fill(text, LEGEND_CHARACTERS),
    )


def _study(axes: Axes, levels: Mapping[str, float], factor: float, factor_text: str):
    names = ", ".join(f"{style.number(level / factor)} ({style.label(label)})" for label, level in levels.items())
    (handle,) = axes.plot(
        np.array(list(levels.values())) / factor,
        np.zeros(len(levels)),
        linestyle="none",
        marker="^",
        color="black",
        markersize=6,
        clip_on=False,
        zorder=5,
        transform=axes.get_xaxis_transform(),
        label=textwrap.fill(f"levels of the study: A = {names} ×{factor_text}", LEGEND_CHARACTERS),
    )
    return handle
