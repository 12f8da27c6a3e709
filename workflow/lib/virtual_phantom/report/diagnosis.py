"""The report of a diagnosis: one HTML file with its pictures inside."""

from __future__ import annotations

import numpy as np

from ..diagnosis.core.fit import Fit
from ..diagnosis.core.look import Look
from ..diagnosis.core.verdict import Diagnosis
from ..diagnosis.projections.prepared import Prepared
from ..figures import diagnosis as figures
from ..physics.effect import load
from .agreement_table import agreement_table
from .html import AGREEMENT, NEXT, PARAMETERS, picture, render

PIXELS_ACROSS = 120  # of the map: more blocks than that hold too few rays to show anything

PAGE = (
    """{% for line in d.caveats %}<p><strong>Caution.</strong> {{ line }}</p>{% endfor %}
{% if d.effects %}<h2>What was left out</h2>
{% for e in d.effects %}<p><strong>{{ e.name.replace('_', ' ') }}</strong>: {{ e.physics }}
{% if d.ambiguous_with[e.name] %}The data explain as well: {{ d.ambiguous_with[e.name]|join(', ')|replace('_', ' ') }}.
{% endif %}</p>
"""
    + PARAMETERS
    + """
<p class="note">Without it, data that were not fitted lose {{ e.evidence.held_out_gain|number }} of log score
{%- if e.evidence.p is not none %};
chance of such a gain for nothing, over all candidates: {{ e.evidence.p|chance }}{% endif %}.
{% if e.taken_from %}Taken as found on {{ e.taken_from }}.{% endif %}
Equation: {{ effects[e.name].equation }}. Source: {{ effects[e.name].source }}.</p>
{% endfor %}{% endif %}
<h2>Where they differ</h2>
<img alt="maps of the residuals before and after" src="{{ maps }}">
<img alt="residuals along three axes" src="{{ profiles }}">
<p class="note">Data not fitted ({{ d.held_out_data }}). Grey: plus and minus 2 standard deviations.</p>
<table><tr><th>domain</th><th>worst place</th><th>z before</th><th>p</th><th>z after</th><th>p</th></tr>
{% for a, b in places %}<tr><td>{{ a.domain }}</td>
<td>{{ a.where }}{% if b.where != a.where %}; after: {{ b.where }}{% endif %}</td>
<td class="n">{{ a.z|number }}</td>
<td class="n">{{ a.p|chance }}</td><td class="n">{{ b.z|number }}</td><td class="n">{{ b.p|chance }}</td></tr>
{% endfor %}</table>
<p class="note">p: corrected for all places of a domain and all domains; under {{ alpha }} counts.</p>
"""
    + AGREEMENT
    + """
{% if d.excess_removed is not none %}<p>Of the difference beyond noise, {{ (100 * d.excess_removed)|round(1) }} %
is removed on data not fitted{% if d.excess_rms_removed is not none %}, {{ (100 * d.excess_rms_removed)|round(1) }} %
of its root mean square{% endif %}.</p>{% endif %}
{{ agreement|safe }}
{% if ranking %}<h2>All candidates</h2>
<img alt="gain of every candidate on held-out data" src="{{ ranking }}">{% endif %}
{% if d.undecided %}<p>Perhaps there beside what is named, though an inexact model of that may look like it (promised
gain in log score): {% for name, gain in d.undecided.items() %}{{ name.replace('_', ' ') }} ({{ gain|number }})
{{- ', ' if not loop.last }}{% endfor %}.</p>{% endif %}
{% if d.ruled_out %}<p>Ruled out as an explanation: {{ d.ruled_out|join(', ')|replace('_', ' ') }}.</p>{% endif %}
"""
    + NEXT
    + """
<h2>Alignment</h2>
<table><tr><th></th><th>value</th><th>95 % interval</th></tr>
{% for name, a in d.alignment.items() %}<tr><td>{{ name }}</td><td class="n">{{ a.value|within(a.ci95) }}</td>
<td>{{ a.ci95[0]|within(a.ci95) }} to {{ a.ci95[1]|within(a.ci95) }}</td></tr>{% endfor %}</table>
<p class="note">Fitted in every model alike: nobody's physics.
{% if d.noise_from_one_repeat %}The recording has one repeat: its noise {{ one_repeat }}.{% endif %}</p>
"""
)


def page(diagnosis: Diagnosis, prepared: Prepared, alpha: float, maps: tuple[np.ndarray, np.ndarray]) -> str:
    """The report as HTML.

    maps   what `residual_maps` gave
    """
    content = diagnosis.content
    after = {place.domain: place for place in diagnosis.after}
    choice, look = diagnosis.choice, prepared.look
    gains = {name: one.score - choice.baseline.score for name, one in choice.singles.items()}
    return render(
        PAGE,
        content,
        effects={one["name"]: load(one["name"]) for one in content["effects"]},
        places=[(place, after[place.domain]) for place in diagnosis.before],
        alpha=alpha,
        agreement=agreement_table(content.get("agreement")),
        maps=picture(figures.draw_maps(*maps, _title(content, prepared), look.across, look.down)),
        profiles=picture(figures.draw_profiles(_profiles(diagnosis, look))),
        one_repeat=look.one_repeat,
        ranking=picture(figures.draw_ranking(gains, choice.chosen.fit.effects)) if gains else None,
    )


def residual_maps(diagnosis: Diagnosis, prepared: Prepared) -> tuple[np.ndarray, np.ndarray]:
    """What the report shows: standardised residuals [down, across] of the data held out, before and after."""
    return tuple(_map(one.fit, prepared) for one in (diagnosis.choice.baseline, diagnosis.choice.chosen))


def _map(fit: Fit, prepared: Prepared) -> np.ndarray:
    """Standardised residual of the data held out: weighted means over one axis and over blocks of rays or voxels."""
    fitter = prepared.fitter
    shape = prepared.held_out.mean.shape
    residual, weight = (part[0].reshape(shape) for part in (fitter.residuals(fit), fitter.held_weights))
    summed = prepared.look.summed
    sums, weights = (residual * weight).sum(axis=summed), weight.sum(axis=summed)
    for axis in (0, 1):
        step = -(-sums.shape[axis] // PIXELS_ACROSS)
        edges = np.arange(0, sums.shape[axis], step)
        sums, weights = (np.add.reduceat(part, edges, axis) for part in (sums, weights))
    return sums / np.sqrt(np.where(weights > 0, weights, np.inf))


def _profiles(diagnosis: Diagnosis, look: Look) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    panels = []
    for domain, label, first in look.profiles:
        before, after = (
            next(one for one in side if one.domain == domain).map for side in (diagnosis.before, diagnosis.after)
        )
        panels.append((label, np.arange(before.size) + first, before, after))
    return panels


def _title(content: dict, prepared: Prepared) -> str:
    return f"{content['recording']}: mean over {('slices', 'rows')[prepared.look.summed]}"
