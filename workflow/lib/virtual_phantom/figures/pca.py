"""Principal components of simulated and measured features (figures 6 to 8 of Flouris et al., Sci. Rep. 2022)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import InputError
from . import style, tables
from .labels import label_points, marker_boxes, to_points

FEW_MEASURED = 100  # measured points that are drawn on top; more are drawn below the simulated ones, with their means
MOST_NAMED = 8  # ROIs with a name in the figure
POINT, LEAST_POINT, MOST_POINT, MEAN_POINT = 3.6, 2.4, 5.0, 8.0  # diameters of markers; of the lowest and highest noise
PALEST = 0.9  # share of white in the fill of the highest noise level
LEGEND_COLUMNS, LEGEND_CHARACTERS = 5, 100  # most columns of the legend, and most letters in one of its lines
WHITE_HALO = [patheffects.withStroke(linewidth=2.4, foreground="white")]
HOLLOW = "none"


@style.styled(grid=True)
def draw(table: pandas.DataFrame, title: str | None = None) -> Figure:
    """Draw principal components, with the color of the tissue class and the shape of the protocol.

    The first panel shows all points: filled if simulated, hollow if measured. The second panel shows the simulated
    points, larger and paler for more noise. A panel that would show nothing new is not drawn. Measured points lie on
    top; if there are more than FEW_MEASURED, they lie below, with larger markers for the means of the ROIs on top. At
    most MOST_NAMED ROIs are named.

    Parameters
    ----------
    table : DataFrame
        Columns source (simulated | measured), protocol, projections, noise_level, seed, roi, tissue_class, pc1, pc2,
        explained_pc1_percent, explained_pc2_percent. The optional column condition (such as the scanner) gives the
        shape of measured rows.

    Raises
    ------
    InputError
        If columns or simulated rows are missing, a source is unknown, or the explained variances differ.
    """
    name = "PCA table"
    tables.check_table(
        table,
        name,
        text=["source", "protocol", "projections", "noise_level", "seed", "roi", "tissue_class"],
        numbers=["pc1", "pc2", "explained_pc1_percent", "explained_pc2_percent"],
    )
    explained = table[["explained_pc1_percent", "explained_pc2_percent"]].drop_duplicates()
    if len(explained) > 1:
        raise InputError(f"{name}: explained variances differ between rows; draw one PCA at a time")
    first, second = explained.iloc[0]
    unknown = sorted(set(table["source"]) - {"simulated", "measured"})
    if unknown:
        raise InputError(f"{name}: source {', '.join(map(str, unknown))} is neither simulated nor measured")
    measured = table[table["source"] == "measured"].assign(shape="")
    if "condition" in measured:
        measured["shape"] = measured["condition"].fillna("").astype(str)
    # sorted by seed, so that no protocol and no noise level is always on top
    simulated = table[table["source"] == "simulated"].sort_values("seed", kind="stable")
    simulated = simulated.assign(shape=simulated["protocol"].astype(str))
    tables.check_table(simulated, f"{name}, simulated rows", numbers=["projections", "noise_level"])
    colors = style.assign([*simulated["tissue_class"], *measured["tissue_class"]], style.ON_WHITE)
    conditions = sorted(set(measured["shape"]) - {""})
    markers = style.assign([*simulated["shape"].unique(), *conditions], style.MARKERS) | {"": "o"}
    levels = sorted(simulated["noise_level"].unique())

    panels = [_all_points] if len(measured) or simulated["shape"].nunique() > 1 or len(levels) == 1 else []
    panels += [_noise_levels] if len(levels) > 1 else []
    legend = _legend(simulated, len(measured), colors, markers, conditions, levels)
    columns = max(1, min(LEGEND_COLUMNS, LEGEND_CHARACTERS // max(len(handle.get_label()) for handle in legend)))
    width = style.DOUBLE_COLUMN_MM if len(panels) > 1 else style.SINGLE_COLUMN_MM
    columns = columns if len(panels) > 1 else max(1, columns // 2)
    figure = style.figure(width, 80 + style.LINE_MM * -(-len(legend) // columns))
    every = np.atleast_1d(figure.subplots(1, len(panels), sharex=True, sharey=True))
    for index, (axes, panel) in enumerate(zip(every, panels, strict=True)):
        text = panel(axes, simulated, measured, colors, markers, levels)
        axes.set_title(text) if len(panels) == 1 else style.letter_panel(axes, index, text)
        axes.set(xlabel=f"PC 1 ({first:.1f} % of variance)", ylabel=None)
    every[0].set_ylabel(f"PC 2 ({second:.1f} % of variance)")
    if title:
        figure.suptitle(title)
    figure.legend(handles=legend, loc="outside lower center", ncols=columns)
    if simulated["roi"].nunique() <= MOST_NAMED:
        figure.draw_without_rendering()  # fixes the layout, on which the placement of names depends
        _name_regions(every[-1], simulated)
    return figure


def _all_points(axes: Axes, simulated, measured, colors, markers, levels: Sequence[float]) -> str:
    """Draw all points, filled if simulated and hollow if measured; return the title."""
    _scatter(axes, simulated, colors, markers, POINT, zorder=2)
    if len(measured) > FEW_MEASURED:
        _scatter(axes, measured, colors, markers, POINT, zorder=1, face=HOLLOW, linewidth=0.4)
        means = measured.groupby(["roi", "tissue_class"], as_index=False)[["pc1", "pc2"]].mean().assign(shape="")
        look = {"linewidth": 1.2, "path_effects": WHITE_HALO}
        _scatter(axes, means, colors, markers, MEAN_POINT, zorder=4, face=HOLLOW, **look)
        return "filled: simulated; hollow: measured\n(large: mean of an ROI)"
    if len(measured):
        _scatter(axes, measured, colors, markers, 1.4 * POINT, zorder=3, face=HOLLOW, linewidth=0.9)
        return "filled: simulated; hollow: measured"
    return "by protocol"


def _noise_levels(axes: Axes, simulated, measured, colors, markers, levels: Sequence[float]) -> str:
    """Draw the simulated points, larger and paler for more noise; return the title."""
    share = {level: index / (len(levels) - 1) for index, level in enumerate(levels)}
    shares = simulated["noise_level"].map(share).to_numpy()
    face = [_paler(colors[name], part) for name, part in zip(simulated["tissue_class"], shares, strict=True)]
    _scatter(axes, simulated, colors, markers, _diameter(shares), zorder=2, face=face, linewidth=0.6)
    return "simulated, by noise level" if len(measured) else "by noise level"


def _name_regions(axes: Axes, rows: pandas.DataFrame) -> None:
    """Write the name of each ROI next to its point that is farthest from the points of other ROIs."""
    data, rois = rows[["pc1", "pc2"]].to_numpy(), rows["roi"].to_numpy()
    places, named, alone = to_points(axes).transform(data), list(dict.fromkeys(rois)), []
    for roi in named:
        own, others = np.flatnonzero(rois == roi), places[rois != roi]
        nearest = [np.hypot(*(others - places[row]).T).min(initial=np.inf) for row in own]
        alone.append(own[int(np.argmax(nearest))])
    label_points(axes, list(map(style.label, named)), data[alone], marker_boxes(axes, data))


def _paler(color: str, share: float) -> tuple[float, ...]:
    """Return a color with white added: 0 adds none, 1 adds PALEST."""
    return tuple(1 - (1 - part) * (1 - PALEST * share) for part in to_rgb(color))


def _diameter(share):
    return LEAST_POINT + (MOST_POINT - LEAST_POINT) * share


def _scatter(axes: Axes, rows: pandas.DataFrame, colors, markers, points, *, face=None, linewidth=0.2, **look) -> None:
    """Draw a marker for every row: its tissue class gives the color of fill or edge, its protocol the shape.

    Parameters
    ----------
    points : float or ndarray, shape (rows,)
        Diameters.
    face : optional
        Colors of the fill with edges of the color of the tissue class; None: white edges.
    """
    drawn = style.scatter(axes, rows["pc1"], rows["pc2"], rows["shape"].map(markers), linewidth=linewidth, **look)
    of_class = rows["tissue_class"].map(colors).tolist()
    drawn.set_facecolor(of_class if face is None else face)
    drawn.set_edgecolor("white" if face is None else of_class)
    drawn.set_sizes(np.array([style.marker_area(markers[shape], 1) for shape in rows["shape"]]) * np.square(points))


def _legend(
    simulated: pandas.DataFrame,
    measured: int,
    colors: Mapping[str, str],
    markers: Mapping[str, str],
    conditions: Sequence[str],
    levels: Sequence[float],
) -> list[Line2D]:
    """Return the entries: tissue classes, protocols, conditions of measured scans, and noise levels."""

    def entry(text: str, marker: str = "o", color: str = style.GREY, points: float = 1.4 * POINT, **look) -> Line2D:
        return Line2D([], [], linestyle="none", marker=marker, color=color, markersize=points, label=text, **look)

    entries = [entry(style.label(name), color=color) for name, color in colors.items()]
    for protocol, rows in simulated.groupby("shape", sort=False):
        projections = ", ".join(style.number(value) for value in sorted(rows["projections"].unique()))
        entries.append(entry(f"{style.label(protocol)}: {projections} projections", markers[protocol]))
    entries += [entry(name, markers[name], markerfacecolor=HOLLOW) for name in conditions]
    if measured and not conditions:
        entries.append(entry("measured", markerfacecolor=HOLLOW))
    factor, unit = style.power_of_ten(levels)
    for index, level in enumerate(levels):
        share = index / max(1, len(levels) - 1)
        text = f"noise level A = {style.number(level / factor)} ×{unit}"
        size = _diameter(share) if len(levels) > 1 else POINT
        entries.append(entry(text, points=size, markerfacecolor=_paler(style.GREY, share)))
    return entries
