"""The report of a diagnosis of features: one HTML file with its pictures inside."""

from __future__ import annotations

from ..diagnosis.core.locate import ALPHA
from ..diagnosis.features.choice import MATERIAL
from ..diagnosis.features.verdict import FeatureDiagnosis
from ..figures import feature_diagnosis as figures
from .html import AGREEMENT, NEXT, PARAMETERS, picture, render

MOST_PLACES = 20

PAGE = (
    """{% if d.effects %}<h2>What differs</h2>
{% for e in d.effects %}<p><strong>{{ e.name.replace('_', ' ') }}</strong>: {{ e.physics }}
{% if d.ambiguous_with[e.name] %}The data explain as well: {{ d.ambiguous_with[e.name]|join(', ')|replace('_', ' ') }}.
{% endif %}</p>
{% if e.parameters %}"""
    + PARAMETERS
    + """{% endif %}
<p class="note">It removes {{ (100 * e.evidence.held_out_gain)|round(1) }} % of the difference on regions that were not
fitted; chance that it would as much of a difference of another origin, over all properties:
{{ e.evidence.p|chance }}. Values are fitted on all regions; intervals are of regions and repeats drawn again.</p>
{% endfor %}{% endif %}
<h2>Where they differ</h2>
<img alt="median shift by family and region, before and after" src="{{ shifts }}">
<p>{{ before }} of {{ tested }} places differ{% if d.effects %}, {{ after }} with the property found{% endif %}.</p>
{% if d.locations %}<table><tr><th>what</th><th>where</th><th>worst feature</th><th>z</th><th>p</th>
<th>features that differ</th></tr>
{% for a in d.locations[:most] %}<tr><td>{{ a.domain }}</td><td>{{ a.where.replace('_', ' ') }}</td>
<td>{{ a.feature.replace('original_', '').replace('_', ' ') }}</td><td class="n">{{ a.z|number }}</td>
<td class="n">{{ a.p|chance }}</td><td class="n">{{ a.differing }} of {{ a.features }}</td></tr>
{% endfor %}</table>
<p class="note">z: positive where the recording holds more. p: corrected for all features, places and domains; under
{{ alpha }} counts. {% if d.locations|length > most %}The first {{ most }}; all are in diagnosis.json.{% endif %}</p>
{% endif %}
"""
    + AGREEMENT
    + """
<p class="note">Standardised shifts of the means, over all features and regions.</p>
<h2>All properties</h2>
<img alt="share of the difference that every property removes" src="{{ shares }}">
{% if d.ruled_out %}<p>Ruled out as the explanation of most of it, removing under {{ (100 * material)|round|int }} %:
{{ d.ruled_out|join(', ')|replace('_', ' ') }}.</p>{% endif %}
"""
    + NEXT
    + """
{% if d.not_compared %}<h2>Not compared</h2>
<table>{% for feature, why in d.not_compared.items() %}<tr><td>{{ feature.replace('original_', '').replace('_', ' ') }}
</td><td>{{ why }}</td></tr>{% endfor %}</table>{% endif %}
"""
)


def page(diagnosis: FeatureDiagnosis) -> str:
    """The report as HTML."""
    trials, found = diagnosis.trials, diagnosis.content["effects"]
    return render(
        PAGE,
        diagnosis.content,
        before=len(diagnosis.before.significant),
        after=len(diagnosis.after.significant),
        tested=len(diagnosis.before.places),
        most=MOST_PLACES,
        alpha=ALPHA,
        material=MATERIAL,
        shifts=picture(figures.draw_shifts(diagnosis.before.cells, diagnosis.after.cells if found else None)),
        shares=picture(
            figures.draw_shares(
                {one.name: trial.fitted for one, trial in trials.items()},
                {one.name: trial.held_out for one, trial in trials.items()},
                tuple(effect["name"] for effect in found),
                MATERIAL,
            )
        ),
    )
