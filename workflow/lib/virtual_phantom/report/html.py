"""What all pages share: templates, one HTML file with its pictures inside, how numbers are written, the verdict."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Undefined
from matplotlib.figure import Figure

from ..base.words import enumerated, label
from ..diagnosis.wording import share
from ..figures import style

SMALL = 1e-3  # what is smaller is written with an exponent
COLOURS = {
    "match": "#009E73",
    "match for practical purposes": "#009E73",
    "mismatch explained": "#0072B2",
    "mismatch partly explained": "#E69F00",
}
OTHER_COLOUR = "#D55E00"

MOST_ROUNDED = 0.05  # of a number: what rounding to an interval's digits may change


def render(template: str, filters: Mapping[str, Callable], *, strict: bool = True, **values) -> str:
    """A page or a part of one, of a template in `templates`.

    Parameters
    ----------
    template : str
        Its name.
    filters : mapping of str to callable
        What the template calls beside `label`, by name.
    strict : bool, optional
        Whether a name that nobody gave is an error, or empty.
    **values
        What the template names.
    """
    environment = Environment(
        loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined if strict else Undefined
    )
    environment.filters |= {"label": label} | filters
    return environment.get_template(f"{template}.html.j2").render(**values)


def render_diagnosis(template: str, content: dict, **values) -> str:
    """A report of a diagnosis.

    Parameters
    ----------
    content : dict
        Of diagnosis.json, `d` in the template.
    **values
        What else the template names; it has the filters number, within (an interval), chance, coverage, share and
        feature.
    """
    filters = {
        "number": number,
        "within": within,
        "chance": _chance,
        "coverage": _coverage,
        "share": share,
        "feature": style.feature_label,
    }
    colour = COLOURS.get(content["verdict"], OTHER_COLOUR)
    return render(template, filters, strict=False, d=content, colour=colour, **values)


def number(value: float) -> str:
    """Three significant digits, with an exponent where it is small."""
    return style.number(value) if value == 0 or abs(value) >= SMALL else f"{value:.1e}"


def within(value: float, interval: list[float]) -> str:
    """A number to two digits of its interval's width; to three significant ones if a one-sided interval hides them."""
    width = interval[1] - interval[0]
    if not 0 < width < np.inf:
        return number(value)
    text = f"{value:.{max(0, 1 - int(np.floor(np.log10(width))))}f}"
    # Of 0.354 in 0.01 to 100, the width says nothing of the digits: the interval is one of factors.
    one_sided = interval[0] >= 0 or interval[1] <= 0
    if one_sided and abs(float(text) - value) > MOST_ROUNDED * abs(value):
        return number(value)
    return text.replace("-", "−")


def _chance(p: float) -> str:
    return "under 1e-300" if p == 0 else number(p)


def _coverage(held: Mapping) -> str:
    """How often intervals for noise alone held the truth (proof_record.with_coverage), in a sentence."""
    every = "{count} of {n} of all effects' parameters".format(**held["all"])
    if held["n"]:
        own = enumerated([label(name) for name in held["effects"]])
        every = f"{held['count']} of {held['n']} of {own}, and in {every}"
    else:
        every += "; of this effect none was counted"
    return (
        "The interval is for noise and for inexact models (model_accuracy). On scans by another simulator "
        f"(docs/validation/blind-validation.md) intervals for noise alone held the truth in {every}."
    )


def picture(figure: Figure) -> str:
    """A figure as a data URL."""
    buffer = io.BytesIO()
    with style.styled():
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return data_url(buffer.getvalue())


def data_url(png: bytes) -> str:
    """A PNG as a data URL."""
    return "data:image/png;base64," + base64.b64encode(png).decode()
