"""What all figures share: widths, type, colours, markers, and how they are saved.

Colours of categories are those of Okabe and Ito (Color Universal Design, 2008), which readers with the common
forms of colour blindness can tell apart; a marker or a name always says the same as the colour. Ordered
parameters use viridis.
"""

import contextlib
import io
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib
import matplotlib.style
import numpy as np
import pandas
import seaborn
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike
from seaborn.utils import relative_luminance

from ..base.words import label
from ..features.names import is_feature
from ..io.files import replacing

SINGLE_COLUMN_MM = 90.0
DOUBLE_COLUMN_MM = 180.0
DOTS_PER_INCH = 200
FONT_POINTS = 7.0
MILLIMETRES_PER_INCH = 25.4
MILLIMETRES_PER_POINT = MILLIMETRES_PER_INCH / 72

ORANGE, SKY_BLUE, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
ON_WHITE = (BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY_BLUE, "#000000", "#666666")
ON_GREY_IMAGE = (ORANGE, SKY_BLUE, GREEN, YELLOW, VERMILLION, PURPLE, BLUE)
MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*", "p", "<", ">", "h", "d", "8", "H")
_MARKER_AREA = {"s": 0.8, "D": 0.75, "P": 1.6, "X": 1.6, "*": 2.0}  # so that all look equally large
GREY = "#666666"
TRIAL, TRIAL_MM = "A trial run: too small to mean anything.", 5.0  # what is said above a figure, and its height
DARK = 0.3  # relative luminance under which white letters have a contrast of 3 and more (WCAG 2.1)

_RC = {
    # Seaborn's proportions, so small that letters at ticks and in legends, 11 points there, have FONT_POINTS.
    **{name: size * FONT_POINTS / 11 for name, size in seaborn.plotting_context("notebook").items()},
    **dict.fromkeys(("font.size", "axes.labelsize", "legend.title_fontsize"), FONT_POINTS),
    "font.family": "DejaVu Sans",  # comes with matplotlib, so every machine sets the same type
    "text.parse_math": False,  # a dollar sign in somebody's ROI name is only a dollar sign
    "figure.titlesize": FONT_POINTS + 1,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#DDDDDD",
    "legend.frameon": False,
    "lines.linewidth": 1.2,  # in the legend, a line of a light colour on white has to be seen
    "pdf.fonttype": 42,
    "savefig.dpi": DOTS_PER_INCH,
    "figure.dpi": DOTS_PER_INCH,
}

# Without dates and versions, equal figures make equal files.
_METADATA = {".png": {"Software": None}, ".pdf": {"Creator": None, "Producer": None, "CreationDate": None}}


def styled(grid: bool = False):
    """Context manager or decorator: within it figures have seaborn's "ticks" in our type, and nothing of the user's.

    Parameters
    ----------
    grid : bool, optional
        Whether axes have one, for values to be read off.

    Returns
    -------
    context manager
        Which is a decorator too.
    """
    return matplotlib.style.context(["default", seaborn.axes_style("ticks"), {**_RC, "axes.grid": grid}])


class ShownFigure(Figure):
    """A figure that a notebook shows by itself; pyplot shows those alone that it has made."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        with styled():
            self.savefig(file, format="png", metadata=_METADATA[".png"])
        return file.getvalue()


def figure(width_mm: float, height_mm: float) -> Figure:
    """An empty figure of this size in mm that no pyplot state knows of."""
    return ShownFigure(
        figsize=(width_mm / MILLIMETRES_PER_INCH, height_mm / MILLIMETRES_PER_INCH), layout="constrained"
    )


@styled()
def save(figure: Figure, paths: Iterable[str | Path], *, trial: bool = False) -> None:
    """Write a figure to every path, its format by the suffix.

    All are written beside their targets before the first is moved into place.

    Parameters
    ----------
    paths : iterable of str or Path
        Ending in .png (200 dpi) or .pdf.
    trial : bool, optional
        Whether it is of a trial run: a line above it then says so.

    Raises
    ------
    ValueError
        On other suffixes.
    """
    paths = [Path(path) for path in paths]
    for path in paths:
        if path.suffix not in _METADATA:
            raise ValueError(f"{path}: figures are written as {' or '.join(_METADATA)}")
    box = _with_trial(figure) if trial else None
    with contextlib.ExitStack() as stack:
        for path in paths:
            temporary = stack.enter_context(replacing(path, checksum=False))
            figure.savefig(temporary, format=path.suffix[1:], metadata=_METADATA[path.suffix], bbox_inches=box)


def _with_trial(figure: Figure) -> Bbox:
    """Write TRIAL above a figure, where nothing of its own moves; returns the box that holds both, inches."""
    figure.draw_without_rendering()  # its layout, which would be another in the larger box
    figure.set_layout_engine("none")
    for legend in figure.legends:
        legend.set_bbox_to_anchor((0, 0, 1, 1), figure.transFigure)
    width, height = figure.get_size_inches()
    strip = TRIAL_MM / MILLIMETRES_PER_INCH
    figure.text(0.5, 1 + strip / height / 2, TRIAL, ha="center", va="center", color=VERMILLION, weight="bold")
    return Bbox.from_bounds(0, 0, width, height + strip)


def number(value: float) -> str:
    """Three significant digits or all before the point, no exponent, a true minus sign: 1488.2 is 1488."""
    text = f"{value:.0f}" if abs(value) >= 999.5 else f"{value:.3g}"
    return (f"{value:.8f}".rstrip("0") if "e" in text else text).replace("-", "−")


def marker_area(marker: str, points: float) -> float:
    """What scatter takes as size, for a marker that looks `points` across."""
    return points**2 * _MARKER_AREA.get(marker, 1.0)


def family_label(family: str) -> str:
    """A pyradiomics feature class as it is read: `firstorder` is First order, short names are acronyms."""
    name = "first order" if family == "firstorder" else label(family)
    return name.upper() if len(name) <= len("ngtdm") else name[:1].upper() + name[1:]


def feature_label(feature: str) -> str:
    """A pyradiomics feature name as it is read: `original_glcm_Idn` is GLCM Idn, a filter's has its name first."""
    if is_feature(feature) and not str(feature).startswith("original_"):
        image, family, name = str(feature).split("_")
        return f"{image} {family_label(family)} {label(name)}"
    family, _, name = str(feature).removeprefix("original_").partition("_")
    return f"{family_label(family)} {label(name)}" if name else label(feature)


def assign(names: Iterable, values: Sequence) -> dict:
    """Give every distinct name, as they appear, the next of `values`, beginning again when they run out."""
    return dict(zip(dict.fromkeys(names), itertools.cycle(values), strict=False))


def letter_panel(axes: Axes, index: int) -> None:
    """Letter a panel: 0 is a."""
    axes.set_title("abcdefghijklmnopqrstuvwxyz"[index % 26], loc="left", fontweight="bold")


def heat_map(axes: Axes, values: pandas.DataFrame, words: ArrayLike, **options) -> QuadMesh:
    """Cells of `values` in colour, with `words` in them; those without a value are grey and have none.

    Parameters
    ----------
    words : array_like, shape of values
    **options
        Of seaborn.heatmap.

    Returns
    -------
    QuadMesh
        What a colour bar is made of.
    """
    seaborn.heatmap(values, annot=words, fmt="", cbar=False, xticklabels=True, yticklabels=True, ax=axes, **options)
    axes.set(facecolor="#EEEEEE", xlabel=None, ylabel=None)
    axes.tick_params(length=0)
    axes.tick_params("y", rotation=0)
    axes.set_xticks(axes.get_xticks(), axes.get_xticklabels(), rotation=60, ha="right", rotation_mode="anchor")
    mesh = axes.collections[0]
    for text in axes.texts:  # seaborn has white ones on middle tones too
        column, row = (int(place) for place in text.get_position())
        dark = relative_luminance(mesh.to_rgba(values.iloc[row, column])) < DARK
        text.set_color("white" if dark else "black")
    return mesh


def power_of_ten(values) -> tuple[float, str]:
    """The factor that small values are shown in, and how it is written.

    Returns
    -------
    factor : float
        The power of ten of their median magnitude: of 2e-4, 1e-4.
    text : str
        Of 2e-4, "10⁻⁴".
    """
    exponent = int(np.floor(np.log10(np.median(np.abs(values)))))
    return 10.0**exponent, "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def noise_levels(levels: Mapping[str, float | None]) -> str:
    """Noise levels, {name: A}, in words: "noise level dose10 (A = 1.24 ×10⁻⁶)"; without a known A the name alone."""
    said = []
    for name, level in levels.items():
        factor, unit = power_of_ten([level]) if level else (1, "")
        said.append(label(name) + (f" (A = {number(level / factor)} ×{unit})" if level else ""))
    return f"noise level{'s' if len(said) > 1 else ''} {', '.join(said)}"


def ordered_colours(values: Iterable[float]) -> dict[float, str]:
    """Every distinct value, in order, with its colour of viridis; its lightest tenth cannot be seen on white."""
    distinct = sorted(set(values))
    return dict(
        zip(distinct, map(to_hex, matplotlib.colormaps["viridis"](np.linspace(0, 0.9, len(distinct)))), strict=True)
    )
