"""The report of a diagnosis: one HTML file with its pictures inside."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable

import numpy as np
from jinja2 import Environment
from matplotlib.figure import Figure

from ..figures import diagnosis as figures
from ..figures import style
from ..physics.effect import load
from .agreement_table import agreement_table
from .fit import Fit
from .prepared import Prepared
from .verdict import Diagnosis

SMALL = 1e-3  # what is smaller is written with an exponent
PIXELS_ACROSS = 120  # of the map: more blocks than that hold too few rays to show anything

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Diagnosis of {{ d.recording }}</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
.verdict { border-left: 6px solid {{ colour }}; background: #f6f6f6; padding: .8rem 1.2rem; font-size: 1.1rem; }
.verdict b { text-transform: uppercase; letter-spacing: .04em; font-size: .85rem; display: block; }
table { border-collapse: collapse; margin: .6rem 0; } td, th { padding: .25rem .9rem .25rem 0; text-align: left;
border-bottom: 1px solid #ddd; vertical-align: top; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
img { max-width: 100%; } .note { color: #555; }
</style></head><body>
<h1>Diagnosis of {{ d.recording }}</h1>
<p class="verdict"><b>{{ d.verdict }}</b>{{ d.sentence }}</p>
{% if d.effects %}<h2>What was left out</h2>
{% for e in d.effects %}<p><strong>{{ e.name.replace('_', ' ') }}</strong>: {{ e.physics }}
{% if d.ambiguous_with[e.name] %}The data explain as well: {{ d.ambiguous_with[e.name]|join(', ')|replace('_', ' ') }}.
{% endif %}</p>
<table><tr><th>parameter</th><th>value</th><th>95 % interval</th><th>unit</th></tr>
{% for name, p in e.parameters.items() %}<tr><td>{{ name }}</td><td class="n">{{ p.value|within(p.ci95) }}</td>
<td>{{ p.ci95[0]|within(p.ci95) }} to {{ p.ci95[1]|within(p.ci95) }}</td><td>{{ p.unit }}</td></tr>{% endfor %}</table>
<p class="note">Without it, data that were not fitted lose {{ e.evidence.held_out_gain|number }} of log score
{%- if e.evidence.p is not none %};
chance of such a gain for nothing, over all candidates: {{ e.evidence.p|chance }}{% endif %}.
{% if e.taken_from %}Taken as found on {{ e.taken_from }}.{% endif %}
Equation: {{ effects[e.name].equation }}. Source: {{ effects[e.name].source }}.</p>
{% endfor %}{% endif %}
<h2>Where they differ</h2>
<img alt="maps of the residuals before and after" src="{{ maps }}">
<img alt="residuals along columns, views and line integrals" src="{{ profiles }}">
<p class="note">Data not fitted ({{ d.held_out_data }}). Grey: plus and minus 2 standard deviations.</p>
<table><tr><th>domain</th><th>worst place</th><th>z before</th><th>p</th><th>z after</th><th>p</th></tr>
{% for a, b in places %}<tr><td>{{ a.domain }}</td><td>{{ a.where }}</td><td class="n">{{ a.z|number }}</td>
<td class="n">{{ a.p|chance }}</td><td class="n">{{ b.z|number }}</td><td class="n">{{ b.p|chance }}</td></tr>
{% endfor %}</table>
<p class="note">p: corrected for all places of a domain and all domains; under {{ alpha }} counts.</p>
<h2>Agreement</h2>
<table><tr><th>on data not fitted</th><th>before</th><th>after</th><th>noise alone</th></tr>
{% for name, m in d.held_out.items() if 'floor' in m %}<tr><td>{{ name.replace('_', ' ') }}</td>
<td class="n">{{ m.before|number }}</td><td class="n">{{ m.after|number }}</td>
<td class="n">{{ m.floor|number }}</td></tr>
{% endfor %}</table>
{% if d.excess_removed is not none %}<p>Of the difference beyond noise, {{ (100 * d.excess_removed)|round(1) }} %
is removed on data not fitted{% if d.excess_rms_removed is not none %}, {{ (100 * d.excess_rms_removed)|round(1) }} %
of its root mean square{% endif %}.</p>{% endif %}
{{ agreement|safe }}
{% if ranking %}<h2>All candidates</h2>
<img alt="gain of every candidate on held-out data" src="{{ ranking }}">{% endif %}
{% if d.ruled_out %}<p>Ruled out as an explanation: {{ d.ruled_out|join(', ')|replace('_', ' ') }}.</p>{% endif %}
{% if d.next_measurement %}<h2>What to measure next</h2><ul>{% for line in d.next_measurement %}
<li>{{ line.replace('_', ' ') }}</li>{% endfor %}</ul>{% endif %}
<h2>Alignment</h2>
<table><tr><th></th><th>value</th><th>95 % interval</th></tr>
{% for name, a in d.alignment.items() %}<tr><td>{{ name }}</td><td class="n">{{ a.value|within(a.ci95) }}</td>
<td>{{ a.ci95[0]|within(a.ci95) }} to {{ a.ci95[1]|within(a.ci95) }}</td></tr>{% endfor %}</table>
<p class="note">Fitted in every model alike: nobody's physics.
{% if d.noise_from_one_repeat %}The recording has one repeat: its noise was taken from second differences
of neighbouring views, so variances and correlations were not tested.{% endif %}</p>
</body></html>
"""
COLOURS = {"match": "#009E73", "mismatch explained": "#0072B2", "mismatch partly explained": "#E69F00"}
OTHER_COLOUR = "#D55E00"


def page(diagnosis: Diagnosis, prepared: Prepared, alpha: float) -> str:
    """The report as HTML."""
    environment = Environment(autoescape=True)
    environment.filters |= {"number": _number, "within": _within, "chance": _chance}
    content = diagnosis.content
    after = {place.domain: place for place in diagnosis.after}
    choice = diagnosis.choice
    gains = {name: one.score - choice.baseline.score for name, one in choice.singles.items()}
    return environment.from_string(PAGE).render(
        d=content,
        colour=COLOURS.get(content["verdict"], OTHER_COLOUR),
        effects={one["name"]: load(one["name"]) for one in content["effects"]},
        places=[(place, after[place.domain]) for place in diagnosis.before],
        alpha=alpha,
        agreement=agreement_table(content.get("agreement")),
        maps=picture(figures.draw_maps(*_maps(diagnosis, prepared), f"{content['recording']}: mean over rows")),
        profiles=picture(figures.draw_profiles(_profiles(diagnosis))),
        ranking=picture(figures.draw_ranking(gains, choice.chosen.fit.effects)) if gains else None,
    )


def _number(value: float) -> str:
    return style.number(value) if value == 0 or abs(value) >= SMALL else f"{value:.1e}"


def _within(value: float, interval: list[float]) -> str:
    """A number to two digits of its interval's width."""
    width = interval[1] - interval[0]
    if not 0 < width < np.inf:
        return _number(value)
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(width))))}f}".replace("-", "−")


def _chance(p: float) -> str:
    return "under 1e-300" if p == 0 else _number(p)


def picture(figure: Figure) -> str:
    """A figure as a data URL."""
    buffer = io.BytesIO()
    with style.styled():
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _maps(diagnosis: Diagnosis, prepared: Prepared) -> tuple[np.ndarray, np.ndarray]:
    return tuple(_map(one.fit, prepared) for one in (diagnosis.choice.baseline, diagnosis.choice.chosen))


def _map(fit: Fit, prepared: Prepared) -> np.ndarray:
    """Standardised residual [view, column] of the data held out: weighted means over rows and blocks of rays."""
    fitter = prepared.fitter
    shape = prepared.held_out.mean.shape
    residual, weight = (part[0].reshape(shape) for part in (fitter.residuals(fit), fitter.held_weights))
    sums, weights = (residual * weight).sum(axis=1), weight.sum(axis=1)
    for axis in (0, 1):
        step = -(-sums.shape[axis] // PIXELS_ACROSS)
        edges = np.arange(0, sums.shape[axis], step)
        sums, weights = (np.add.reduceat(part, edges, axis) for part in (sums, weights))
    return sums / np.sqrt(np.where(weights > 0, weights, np.inf))


def _profiles(diagnosis: Diagnosis) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    pairs = {}
    for key in ("columns", "views", "path length"):
        maps = [next(one for one in side if one.domain == key).map for side in (diagnosis.before, diagnosis.after)]
        pairs[key] = maps
    labels: dict[str, tuple[str, Callable]] = {
        "columns": ("detector column", np.arange),
        "views": ("view", np.arange),
        "path length": ("line integral (tenth)", lambda n: np.arange(n) + 1),
    }
    return [(labels[key][0], labels[key][1](before.size), before, after) for key, (before, after) in pairs.items()]
