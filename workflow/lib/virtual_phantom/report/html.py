"""What all reports of diagnoses share: one HTML file with its pictures inside, how numbers are written, the verdict."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping

import numpy as np
from jinja2 import Environment
from matplotlib.figure import Figure

from ..figures import style

SMALL = 1e-3  # what is smaller is written with an exponent
STYLE = """body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; margin: .6rem 0; } td, th { padding: .25rem .9rem .25rem 0; text-align: left;
border-bottom: 1px solid #ddd; vertical-align: top; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
img { max-width: 100%; } .note { color: #555; }
"""
HEAD = (
    """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Diagnosis of {{ d.recording }}</title>
<style>
"""
    + STYLE
    + """.verdict { border-left: 6px solid {{ colour }}; background: #f6f6f6; padding: .8rem 1.2rem;
font-size: 1.1rem; }
.verdict b { text-transform: uppercase; letter-spacing: .04em; font-size: .85rem; display: block; }
</style></head><body>
<h1>Diagnosis of {{ d.recording }}</h1>
<p class="verdict"><b>{{ d.verdict }}</b>{{ d.sentence }}</p>
"""
)
# Parts of templates: an effect `e` with its parameters, metrics on data held out, what to do next.
PARAMETERS = """<table><tr><th>parameter</th><th>value</th><th>95 % interval</th><th>unit</th></tr>
{% for name, p in e.parameters.items() %}<tr><td>{{ name }}</td><td class="n">{{ p.value|within(p.ci95) }}</td>
<td>{{ p.ci95[0]|within(p.ci95) }} to {{ p.ci95[1]|within(p.ci95) }}</td><td>{{ p.unit -}}
{% if p.tried %}, tried {{ p.tried[0]|number }} to {{ p.tried[1]|number }}{% endif %}</td></tr>
{% endfor %}</table>
{% for p in e.parameters.values() %}{% if loop.first and p.ci95_held %}
<p class="note">{{ p.ci95_held|coverage }}</p>{% endif %}{% endfor %}"""
AGREEMENT = """<h2>Agreement</h2>
<table><tr><th>on data not fitted</th><th>before</th><th>after</th><th>noise alone</th></tr>
{% for name, m in d.held_out.items() if 'floor' in m %}<tr><td>{{ name.replace('_', ' ') }}</td>
<td class="n">{{ m.before|number }}</td><td class="n">{{ m.after|number }}</td>
<td class="n">{{ m.floor|number }}</td></tr>
{% endfor %}</table>"""
NEXT = """{% if d.next_measurement %}<h2>What to measure next</h2><ul>{% for line in d.next_measurement %}
<li>{{ line.replace('_', ' ') }}</li>{% endfor %}</ul>{% endif %}"""
FOOT = "</body></html>\n"
COLOURS = {"match": "#009E73", "mismatch explained": "#0072B2", "mismatch partly explained": "#E69F00"}
OTHER_COLOUR = "#D55E00"


def render(body: str, content: dict, **values) -> str:
    """A report: the head with the verdict, then a template of what follows.

    content   of diagnosis.json, `d` in the template
    values    what else the template names; it has the filters number, within (an interval), chance and coverage
    """
    environment = Environment(autoescape=True)
    environment.filters |= {"number": number, "within": _within, "chance": _chance, "coverage": _coverage}
    colour = COLOURS.get(content["verdict"], OTHER_COLOUR)
    return environment.from_string(HEAD + body + FOOT).render(d=content, colour=colour, **values)


def number(value: float) -> str:
    """Three significant digits, with an exponent where it is small."""
    return style.number(value) if value == 0 or abs(value) >= SMALL else f"{value:.1e}"


def _within(value: float, interval: list[float]) -> str:
    """A number to two digits of its interval's width."""
    width = interval[1] - interval[0]
    if not 0 < width < np.inf:
        return number(value)
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(width))))}f}".replace("-", "−")


def _chance(p: float) -> str:
    return "under 1e-300" if p == 0 else number(p)


def _coverage(held: Mapping) -> str:
    """How often such intervals held the truth (proof_record.with_coverage), in a sentence."""
    every = "{count} of {n} of all effects' parameters".format(**held["all"])
    if held["n"]:
        own = " and ".join(style.label(name) for name in held["effects"])
        every = f"{held['count']} of {held['n']} of {own}, and in {every}"
    else:
        every += "; of this effect none was counted"
    return (
        "The interval is that of the noise, if the model is right. On scans by another simulator (docs/proof.md) such "
        f"intervals held the truth in {every}."
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
