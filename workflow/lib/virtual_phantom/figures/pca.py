"""Principal components, simulated and measured (figures 6 to 8 of Flouris et al., Sci. Rep. 2022)."""

import numpy as np
import pandas
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from . import style, tables

FEW_MEASURED = 100  # up to as many lie on top; more lie beneath, with their means on top
SIMULATED_POINTS, MEASURED_POINTS, MEAN_POINTS = 3.4, 4.5, 8.0  # across
WHITE_HALO = [patheffects.withStroke(linewidth=2.4, foreground="white")]


@style.styled(grid=True)
def draw(table: pandas.DataFrame, title: str | None = None) -> Figure:
    """Two panels of the same points, a marker per ROI, coloured by number of projections and by noise level.

    table: source (simulated | measured), projections, noise_level, seed, roi, pc1, pc2,
    explained_pc1_percent, explained_pc2_percent.
    Measured rows, if any, are hollow black markers of their ROI's shape, on top of the simulated; if they are
    more than FEW_MEASURED, they lie beneath, and the mean of each ROI's is a larger one on top.
    Raises InputError if columns or simulated rows lack, or the explained variances are not one pair.
    """
    name = "PCA table"
    tables.check_table(
        table,
        name,
        text=["source", "projections", "noise_level", "seed", "roi"],
        numbers=["pc1", "pc2", "explained_pc1_percent", "explained_pc2_percent"],
    )
    explained = table[["explained_pc1_percent", "explained_pc2_percent"]].drop_duplicates()
    if len(explained) > 1:
        raise InputError(f"{name}: explained variances differ between rows; draw one PCA at a time")
    unknown = sorted(set(table["source"]) - {"simulated", "measured"})
    if unknown:
        raise InputError(f"{name}: source {', '.join(map(str, unknown))} is neither simulated nor measured")
    measured = table[table["source"] == "measured"]
    # by seed, so that no value of a parameter always lies on top of the others
    simulated = table[table["source"] == "simulated"].sort_values("seed", kind="stable")
    tables.check_table(simulated, f"{name}, simulated rows", numbers=["projections", "noise_level"])
    markers = style.assign([*simulated["roi"], *measured["roi"]], style.MARKERS)

    legend_rows = -(-(len(markers) + 3) // 5)
    figure = style.figure(style.DOUBLE_COLUMN_MM, 88 + 4 * legend_rows)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    factor, factor_text = style.power_of_ten(simulated["noise_level"])
    for index, (axes, values, parameter) in enumerate(
        zip(
            panels,
            (simulated["projections"], simulated["noise_level"] / factor),
            ("number of projections", f"noise level A = 1/I₀ ({factor_text})"),
            strict=True,
        )
    ):
        mappable, steps = style.parameter_colours(values.to_numpy(dtype=float))
        _simulated(axes, simulated, markers, mappable.to_rgba(values))
        _measured(axes, measured, markers)
        bar = figure.colorbar(
            mappable,
            ax=axes,
            location="top",
            label=parameter,
            aspect=30,
            pad=0.02,
            spacing="uniform",
            drawedges=False,
        )
        if steps is not None:
            bar.set_ticks(
                (mappable.norm.boundaries[1:] + mappable.norm.boundaries[:-1]) / 2,
                labels=[style.number(step) for step in steps],
            )
            bar.ax.tick_params(length=0)
        bar.ax.text(
            -0.03,
            0.5,
            "ab"[index],
            transform=bar.ax.transAxes,
            ha="right",
            va="center",
            fontweight="bold",
            fontsize=style.FONT_POINTS + 1,
        )
        axes.set_xlabel(f"PC 1 ({explained.iloc[0, 0]:.1f} % of variance)")
    panels[0].set_ylabel(f"PC 2 ({explained.iloc[0, 1]:.1f} % of variance)")
    if title:
        figure.suptitle(title)
    _legend(figure, markers, len(measured))
    return figure


def _simulated(axes: Axes, rows: pandas.DataFrame, markers: dict[str, str], colours: np.ndarray) -> None:
    """Filled markers; colours: one of RGBA for each row."""
    rois = rows["roi"].to_numpy()
    for roi in dict.fromkeys(rois):
        chosen = rois == roi
        axes.scatter(
            rows["pc1"][chosen],
            rows["pc2"][chosen],
            marker=markers[roi],
            facecolors=colours[chosen],
            s=style.marker_area(markers[roi], SIMULATED_POINTS),
            edgecolors="white",
            linewidths=0.2,
            zorder=2,
        )


def _measured(axes: Axes, rows: pandas.DataFrame, markers: dict[str, str]) -> None:
    """Hollow black markers."""
    many = len(rows) > FEW_MEASURED
    size, width, order = (SIMULATED_POINTS, 0.4, 1) if many else (MEASURED_POINTS, 0.7, 3)
    for roi, points in rows.groupby("roi"):
        hollow = {"marker": markers[roi], "facecolors": "none", "edgecolors": "black"}
        axes.scatter(
            points["pc1"],
            points["pc2"],
            s=style.marker_area(markers[roi], size),
            linewidths=width,
            zorder=order,
            **hollow,
        )
        if many:
            axes.scatter(
                points["pc1"].mean(),
                points["pc2"].mean(),
                s=style.marker_area(markers[roi], MEAN_POINTS),
                linewidths=1.2,
                zorder=4,
                path_effects=WHITE_HALO,
                **hollow,
            )


def _legend(figure: Figure, markers: dict[str, str], measured: int) -> None:
    def entry(marker, size, text, **look):
        return Line2D(
            [],
            [],
            linestyle="none",
            marker=marker,
            markersize=np.sqrt(style.marker_area(marker, size)),
            label=text,
            **look,
        )

    handles = [entry(marker, 5, style.label(roi), color=style.GREY) for roi, marker in markers.items()]
    middle = style.parameter_colours(np.array([0.0]))[0].to_rgba(0.0)
    handles.append(entry("o", 5, "colour: simulated", color=middle))
    if measured:
        handles.append(entry("o", 5, "black: measured", color="black", markerfacecolor="none"))
    if measured > FEW_MEASURED:
        handles.append(
            entry("o", 8, "large: mean of measured", color="black", markerfacecolor="none", markeredgewidth=1.2)
        )
    figure.legend(handles=handles, loc="outside lower center", ncols=min(5, len(handles)))
