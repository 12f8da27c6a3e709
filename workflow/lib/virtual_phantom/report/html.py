"""Common parts of the pages: templates, embedded pictures, number formats and colors of verdicts."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping
from datetime import date

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Undefined
from matplotlib.figure import Figure

from .. import __version__
from ..base.names import enumerated, label
from ..diagnosis.verdict_text import percent
from ..figures import style

SMALL = 1e-3  # smaller numbers are written with an exponent
COLORS = {  # {verdict: color}
    "match": "#009E73",
    "match for practical purposes": "#009E73",
    "mismatch explained": "#0072B2",
    "mismatch partly explained": "#E69F00",
}
OTHER_COLOR = "#D55E00"
MOST_ROUNDED = 0.05  # largest relative change by rounding to the digits of an interval


def render(template: str, filters: Mapping[str, Callable], *, strict: bool = True, **values) -> str:
    """Render a template of `templates`, which may use the version of Virtual Phantom and the date.

    Parameters
    ----------
    filters : mapping of str to callable
        Filters of the template in addition to `label`.
    strict : bool, optional
        Whether an undefined variable is an error (otherwise it is empty).
    """
    environment = Environment(
        loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined if strict else Undefined
    )
    environment.filters |= {"label": label} | filters
    environment.globals |= {"version": __version__, "date": date.today().isoformat()}
    return environment.get_template(f"{template}.html.j2").render(**values)


def render_diagnosis(template: str, content: dict, **values) -> str:
    """Render a report of a diagnosis, with the content of diagnosis.json as `d` in the template."""
    filters = {"number": number, "within": within, "chance": _chance, "coverage": _coverage, "share": percent}
    filters["feature"] = style.feature_label
    colour = COLORS.get(content["verdict"], OTHER_COLOR)
    return render(template, filters, strict=False, d=content, colour=colour, **values)


def number(value: float) -> str:
    """Format a number with three significant digits, and with an exponent if it is small."""
    return style.number(value) if value == 0 or abs(value) >= SMALL else f"{value:.1e}"


def within(value: float, interval: list[float]) -> str:
    """Format a number with as many decimals as give two significant digits of the width of its interval.

    If a wide interval on one side of 0 leaves too few, as for 0.354 in 0.01 to 100, use three significant digits.
    """
    width = interval[1] - interval[0]
    if not 0 < width < np.inf:
        return number(value)
    text = f"{value:.{max(0, 1 - int(np.floor(np.log10(width))))}f}"
    one_sided = interval[0] >= 0 or interval[1] <= 0
    if one_sided and abs(float(text) - value) > MOST_ROUNDED * abs(value):
        return number(value)
    return text.replace("-", "−")


def _chance(p: float) -> str:
    return "under 1e-300" if p == 0 else number(p)


def _coverage(held: Mapping) -> str:
    """Describe the coverage of 95 % intervals (proof_record.with_coverage) in a sentence."""
    counts = "{count} of {n} parameters of all effects".format(**held["all"])
    if held["n"]:
        effects = enumerated([label(name) for name in held["effects"]])
        counts = f"{held['count']} of {held['n']} parameters of {effects} and of {counts}"
    else:
        counts += " (none of this effect were tested)"
    return (
        "The interval includes noise and model errors (model_accuracy). In the blind validation, such intervals "
        f"covered the true values of {counts}."
    )


def picture(figure: Figure) -> str:
    """Return a figure as a data URL."""
    buffer = io.BytesIO()
    with style.styled():
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return data_url(buffer.getvalue())


def data_url(png: bytes) -> str:
    """Return a PNG as a data URL."""
    return "data:image/png;base64," + base64.b64encode(png).decode()
