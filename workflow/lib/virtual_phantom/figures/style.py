"""Common style of all figures: widths, fonts, colors, markers and output files.

Categories have the colors of Okabe and Ito (Color Universal Design, 2008), which readers with common color vision
deficiencies can distinguish. A marker or a name repeats the information.
"""

import contextlib
import io
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib.style
import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.textpath import TextPath
from matplotlib.ticker import FuncFormatter
from matplotlib.transforms import Bbox, ScaledTranslation
from numpy.typing import ArrayLike

from ..base.names import label
from ..features.names import is_feature
from ..io.files import replacing

SINGLE_COLUMN_MM = 85.0
DOUBLE_COLUMN_MM = 170.0
DOTS_PER_INCH = 200
FONT_POINTS = 7.0
MILLIMETRES_PER_INCH = 25.4
MILLIMETRES_PER_POINT = MILLIMETRES_PER_INCH / 72
LINE = 1.45  # distance of lines of text, relative to the font size
COLUMN_GAP = 8.0  # between columns of text, points
LINE_MM = LINE * FONT_POINTS * MILLIMETRES_PER_POINT

ORANGE, SKY_BLUE, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILLION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
ON_WHITE = (BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY_BLUE, "#000000", "#666666")
ON_GRAY_IMAGE = (ORANGE, SKY_BLUE, GREEN, YELLOW, VERMILLION, PURPLE, BLUE)
MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*", "p", "<", ">", "h", "d", "8", "H")
_MARKER_AREA = {"s": 0.8, "D": 0.75, "P": 1.6, "X": 1.6, "*": 2.0}  # factors that make all markers look equally large
GREY = "#666666"
TRIAL, TRIAL_MM = "Trial run: too small for meaningful results.", 5.0  # line above a figure, and its height
DARK = 0.3  # relative luminance below which white letters have a contrast of at least 3 (WCAG 2.1)

# Style "ticks" and proportions "notebook" of seaborn 0.13, in which tick labels and legends have 11 points.
_TICKS = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), ".15"),
    "axes.axisbelow": True,
    "lines.solid_capstyle": "round",
    "patch.edgecolor": "white",
    "patch.force_edgecolor": True,
}
_NOTEBOOK = {
    **dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 1.25),
    **dict.fromkeys(("grid.linewidth", "patch.linewidth", "xtick.minor.width", "ytick.minor.width"), 1),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size", "lines.markersize"), 6),
    **dict.fromkeys(("xtick.minor.size", "ytick.minor.size"), 4),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 11),
    "axes.titlesize": 12,
}
_RC = {
    **_TICKS,
    **{name: size * FONT_POINTS / 11 for name, size in _NOTEBOOK.items()},
    **dict.fromkeys(("font.size", "axes.labelsize", "legend.title_fontsize"), FONT_POINTS),
    "font.family": "DejaVu Sans",  # part of matplotlib, so figures look the same on all machines
    "text.parse_math": False,  # names of ROIs may contain dollar signs
    "figure.titlesize": FONT_POINTS + 1,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#DDDDDD",
    "legend.frameon": False,
    "lines.linewidth": 1.2,  # makes lines of light colors visible in legends
    "pdf.fonttype": 42,
    "savefig.dpi": DOTS_PER_INCH,
    "figure.dpi": DOTS_PER_INCH,
}

# Without dates and versions, equal figures give equal files.
_METADATA = {".png": {"Software": None}, ".pdf": {"Creator": None, "Producer": None, "CreationDate": None}}


def styled(grid: bool = False):
    """Return a context manager and decorator that applies this style without settings of the user."""
    return matplotlib.style.context(["default", {**_RC, "axes.grid": grid}])


class ShownFigure(Figure):
    """Figure that a notebook displays although pyplot did not create it."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        with styled():
            self.savefig(file, format="png", metadata=_METADATA[".png"])
        return file.getvalue()


def figure(width_mm: float, height_mm: float) -> Figure:
    """Create an empty figure, outside of pyplot's state."""
    return ShownFigure(
        figsize=(width_mm / MILLIMETRES_PER_INCH, height_mm / MILLIMETRES_PER_INCH), layout="constrained"
    )


@styled()
def save(figure: Figure, paths: Iterable[str | Path], *, trial: bool = False) -> None:
    """Write a figure to all paths, in the format of their suffix.

    All files are complete before the first is moved to its path.

    Parameters
    ----------
    paths : iterable of str or Path
        Paths that end in .png (200 dpi) or .pdf.
    trial : bool, optional
        Whether to write a line above the figure that it is from a trial run.

    Raises
    ------
    ValueError
        For other suffixes.
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
    """Write TRIAL above a figure without changing its layout; return the box of both, inches."""
    figure.draw_without_rendering()  # fixes the layout
    figure.set_layout_engine("none")
    for legend in figure.legends:
        legend.set_bbox_to_anchor((0, 0, 1, 1), figure.transFigure)
    width, height = figure.get_size_inches()
    strip = TRIAL_MM / MILLIMETRES_PER_INCH
    figure.text(0.5, 1 + strip / height / 2, TRIAL, ha="center", va="center", color=VERMILLION, weight="bold")
    return Bbox.from_bounds(0, 0, width, height + strip)


def number(value: float) -> str:
    """Format a number with three significant digits or as an integer (1488.2 is 1488), without an exponent."""
    text = f"{value:.0f}" if abs(value) >= 999.5 else f"{value:.3g}"
    return (f"{value:.8f}".rstrip("0") if "e" in text else text).replace("-", "−")


def number_formatter() -> FuncFormatter:
    """Return a formatter of tick labels that writes numbers as `number` does."""
    return FuncFormatter(lambda value, _: number(value))


def marker_area(marker: str, points: float) -> float:
    """Return the size for scatter at which a marker seems to have a diameter of `points`."""
    return points**2 * _MARKER_AREA.get(marker, 1.0)


def family_label(family: str) -> str:
    """Return the label of a pyradiomics feature class: "First order" for firstorder, "GLCM" for glcm."""
    name = "first order" if family == "firstorder" else label(family)
    return name.upper() if len(name) <= len("ngtdm") else name[:1].upper() + name[1:]


def feature_label(feature: str) -> str:
    """Return the label of a feature: "GLCM Idn" for original_glcm_Idn; filters other than original are named first."""
    if is_feature(feature) and not str(feature).startswith("original_"):
        image, family, name = str(feature).split("_")
        return f"{image} {family_label(family)} {label(name)}"
    family, _, name = str(feature).removeprefix("original_").partition("_")
    return f"{family_label(family)} {label(name)}" if name else label(feature)


def assign(names: Iterable, values: Sequence) -> dict:
    """Assign `values` to the distinct names in order of appearance; values repeat if there are too few."""
    return dict(zip(dict.fromkeys(names), itertools.cycle(values), strict=False))


def scatter(axes: Axes, x: ArrayLike, y: ArrayLike, markers: Iterable[str], **look) -> PathCollection:
    """Draw points with a marker of each, in one collection with white edges; `look`: see Axes.scatter."""
    points = axes.scatter(x, y, edgecolor="white", **look)
    shapes = {marker: MarkerStyle(marker) for marker in MARKERS}
    points.set_paths([shapes[marker].get_path().transformed(shapes[marker].get_transform()) for marker in markers])
    return points


def scatter_families(
    axes: Axes, rows: pandas.DataFrame, x: str, y: str, families: Sequence[str], **look
) -> list[Line2D]:
    """Draw two columns with the color and marker of each feature family; return the entries of a legend."""
    colors, markers = assign(families, ON_WHITE), assign(families, MARKERS)
    shapes, own = rows["family"].map(markers), rows["family"].map(colors).tolist()
    scatter(axes, rows[x], rows[y], shapes, color=own, alpha=0.75, linewidth=0.4, zorder=2, **look)
    entry = {"linestyle": "", "alpha": 0.75, "markeredgecolor": "white", "markeredgewidth": 0.4}
    return [
        Line2D([], [], marker=markers[name], color=colors[name], label=family_label(name), **entry) for name in families
    ]


def bars(axes: Axes, names: Sequence[str], lengths: ArrayLike, color, height: float = 0.8) -> None:
    """Draw horizontal bars, the first at the top, in one color or one for each."""
    axes.barh(range(len(names)), lengths, height, color=color)
    axes.set_yticks(range(len(names)), names)
    axes.yaxis.grid(False)
    axes.set_ylim(len(names) - 0.5, -0.5, auto=None)  # marks that follow may change the limits


def letter_panel(axes: Axes, index: int, title: str | None = None) -> None:
    """Write the letter of a panel, a for index 0, and to its right a title of any number of lines."""
    letter = "abcdefghijklmnopqrstuvwxyz"[index % 26]
    if title is not None:
        letter += "\n" * title.count("\n")  # in the first line
    axes.set_title(letter, loc="left", fontweight="bold")
    if title is not None:
        text = axes.set_title(title, ha="left", x=0)
        shift = ScaledTranslation(2 * FONT_POINTS / 72, 0, axes.get_figure().dpi_scale_trans)
        text.set_transform(text.get_transform() + shift)


def write_columns(figure: Figure, columns: Sequence[tuple[str, Sequence[str]]], note: str) -> None:
    """Write columns of text, each with its heading, and a note at the bottom of a figure; the panels stay above."""
    width, height = 72 * figure.get_size_inches()
    rows, notes = max(len(texts) for _, texts in columns), note.splitlines()
    top = (1 + rows + len(notes)) * LINE * FONT_POINTS
    figure.get_layout_engine().set(rect=(0, top / height, 1, 1 - top / height))

    def write(text: str, left: float, line: int, color: str) -> None:
        y = (top - (line + 0.75) * LINE * FONT_POINTS) / height
        figure.text(left / width, y, text, color=color, va="baseline")

    left = COLUMN_GAP / 2
    for heading, texts in columns:
        for line, text in enumerate([heading, *texts]):
            write(text, left, line, "black" if line else GREY)
        widths = [TextPath((0, 0), text, size=FONT_POINTS).get_extents().width for text in [heading, *texts] if text]
        left += COLUMN_GAP + max(widths)
    for line, text in enumerate(notes, 1 + rows):
        write(text, COLUMN_GAP / 2, line, GREY)


def heat_map(axes: Axes, values: pandas.DataFrame, words: ArrayLike | None = None, **options) -> QuadMesh:
    """Draw a heat map, with `words` in its cells if given; cells without a value are gray and empty.

    Parameters
    ----------
    words : array_like, shape of values, optional
    **options
        Options of Axes.pcolormesh.

    Returns
    -------
    QuadMesh
        Mappable for a color bar.
    """
    cells = np.ma.masked_invalid(values.to_numpy(float))
    mesh = axes.pcolormesh(cells, **options)
    rows, columns = cells.shape
    axes.set(facecolor="#EEEEEE", xlim=(0, columns), ylim=(rows, 0))
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.set_yticks(np.arange(rows) + 0.5, values.index, va="center")
    axes.set_xticks(np.arange(columns) + 0.5, values.columns, rotation=60, ha="right", rotation_mode="anchor")
    for (row, column), word in () if words is None else np.ndenumerate(np.asarray(words)):
        if cells[row, column] is not np.ma.masked:
            color = "white" if _luminance(mesh.to_rgba(cells[row, column])) < DARK else "black"
            axes.text(column + 0.5, row + 0.5, word, color=color, ha="center", va="center")
    return mesh


def _luminance(color) -> float:
    """Return the relative luminance of a color (WCAG 2.1)."""
    rgb = np.array(to_rgb(color))
    return float(np.where(rgb <= 0.03928, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722))


def power_of_ten(values) -> tuple[float, str]:
    """Return the power of ten of the median absolute value, and its text: 1e-4 and "10⁻⁴" for 2e-4."""
    exponent = int(np.floor(np.log10(np.median(np.abs(values)))))
    return 10.0**exponent, "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def noise_levels(levels: Mapping[str, float | None]) -> str:
    """Describe noise levels {name: A or None}: "noise level dose10 (A = 1.24 ×10⁻⁶)"."""
    texts = []
    for name, level in levels.items():
        factor, unit = power_of_ten([level]) if level else (1, "")
        texts.append(label(name) + (f" (A = {number(level / factor)} ×{unit})" if level else ""))
    return f"noise level{'s' if len(texts) > 1 else ''} {', '.join(texts)}"


def noise_sentence(levels: Mapping[str, float | None]) -> str:
    """Return `noise_levels` as a sentence."""
    text = noise_levels(levels)
    return f"{text[0].upper()}{text[1:]}."
