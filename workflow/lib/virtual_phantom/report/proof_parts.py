"""Templates of the page's parts. `s` is the score; filters are those of proof.page."""

RECORD = """{% if s.record.seeds %}{% set r = s.record %}<h2>All seeds that were looked at</h2>
<table><tr><th></th>{% for one in r.seeds if one.counts %}<th class="n">seed {{ one.seed }}</th>{% endfor %}
<th>unseen seeds, pooled</th></tr>
{% for name, what in r.quantities.items() %}<tr><td>{{ what }}</td>
{% for one in r.seeds if one.counts %}<td class="n">{{ one.counts[name]|join(' of ') }}</td>{% endfor %}
<td>{{ r.pooled[name]|tally }}</td></tr>
{% endfor %}</table>
<p class="note">{{ r.meaning }}</p>
<ul class="note">{% for one in r.seeds %}<li>Seed {{ one.seed }} ({{ 'unseen' if one.unseen else 'not unseen' }}
{%- if one.counts %}, code {{ one.state }}{% endif %}): {{ one.note }}</li>{% endfor %}</ul>{% endif %}
"""

HEADLINE = """<h2>What had to be reached{% if s.suite.seed is defined %}, seed {{ s.suite.seed }}{% endif %}</h2>
<table><tr><th></th><th class="n">found</th><th class="n">95 % interval</th><th class="n">target</th>
<th class="n">cases</th><th></th></tr>
{% for t in s.targets %}{% set cls, word = t|reached %}<tr><td>{{ t.what }}</td>
<td class="n">{{ t.value|valued(t) }}</td>
<td class="n">{% if t.ci95 %}{{ t.ci95[0]|percent }} to {{ t.ci95[1]|percent }}{% endif %}</td>
<td class="n">{{ t.sense }} {{ t.target|valued(t) }}</td><td class="n">{{ '' if t.n is none else t.n }}</td>
<td class="{{ cls }}">{{ word }}</td></tr>
{% endfor %}</table>
<p class="note">Intervals of shares: Wilson's.</p>
<h2>What was concealed, and what was named first</h2>
<img alt="confusion matrix" src="{{ matrix }}">
<p class="note">{{ s.confusion.meaning }}
{% if s.confusion.pairs_left_out %}Cases with two effects ({{ s.confusion.pairs_left_out }}) are counted in the
table below.{% endif %}</p>
"""

MODELS = """{% set e = s.effects %}<h2>Whose models they are</h2>
<p>{{ e.can_be_concealed }} of the library's {{ e.library }} effects can be concealed
{%- if e.never_concealed %}; never is {{ e.never_concealed|map('label')|join(', ') }}, of which the proof says
nothing{% endif %}.</p>
<table><tr><th>made by</th><th>effects of the library, concealed here</th><th>named first</th>
<th>95 % intervals that hold the truth</th><th>effects that the library lacks</th></tr>
{% for model, made in e.models.items() %}<tr><td>{{ model }}</td>
<td>{{ made.concealed|map('label')|join(', ') or '–' }}</td><td>{{ s.accuracy.first.by_model[model]|tally }}</td>
<td>{{ s.parameters.by_model[model].covered|tally }}</td>
<td>{{ made.lacking|map('label')|join(', ') or '–' }}</td></tr>
{% endfor %}</table>
<p class="note">{{ e.meaning }}</p>
"""

ACCURACY = """{% set a = s.accuracy %}<h2>How often it is right</h2>
<table><tr><th>one effect of the library</th><th>named first</th><th>first, or reported as its equal</th></tr>
{% for name, share in a.first.by_strength.items() %}<tr><td>{{ name }}</td><td>{{ share|tally }}</td>
<td>{{ a.first_or_stand_in.by_strength[name]|tally }}</td></tr>{% endfor %}
{% for name, share in a.first.by_kind.items() %}<tr><td>recordings of {{ name }}</td><td>{{ share|tally }}</td>
<td>{{ a.first_or_stand_in.by_kind[name]|tally }}</td></tr>{% endfor %}
<tr><td>all</td><td>{{ a.first.all|tally }}</td><td>{{ a.first_or_stand_in.all|tally }}</td></tr></table>
<table><tr><th>everything else</th><th></th></tr>
<tr><td>two effects: both named</td><td>{{ a.pairs.both_named|tally }}</td></tr>
<tr><td>two effects: both named, or reported as equals</td><td>{{ a.pairs.both_named_or_stand_ins|tally }}</td></tr>
<tr><td>two effects: one at least</td><td>{{ a.pairs.one_named|tally }}</td></tr>
<tr><td>one or two effects: something else named too, or instead</td><td>{{ a.beside|tally }}</td></tr>
<tr><td>one or two effects, all named: something left unexplained all the same</td><td>{{ a.left_open|tally }}</td></tr>
<tr><td>nothing concealed: false alarms</td><td>{{ a.false_alarms|tally }}</td></tr>
<tr><td>an effect that the library lacks: unexplained or partly explained</td><td>{{ a.unknown|tally }}</td></tr>
<tr><td>precisely the concealed effects named</td><td>{{ a.exact.all|tally }}</td></tr>
<tr><td>a difference found in a domain where it should show</td><td>{{ a.located|tally }}</td></tr>
</table>
{% set x = s.excess_removed %}<table><tr><th>what is removed, and what is left</th><th class="n">cases</th>
<th class="n">excess removed, median</th><th class="n">tenth percentile</th>
<th class="n">left, standard deviations: median</th><th class="n">ninetieth percentile</th><th class="n">most</th></tr>
{% for key, what in (('in_library', 'one or two effects of the library'),
('projections', 'of these, projections'), ('images', 'of these, images'),
('right', 'something concealed, precisely that named'),
('wrong', 'something named that was not concealed'), ('lacking', 'an effect that the library lacks')) %}
{% set one = x[key] %}<tr><td>{{ what }}{% if one.counted_as_0 %} ({{ one.counted_as_0 }} without a value counted as 0)
{%- endif %}</td><td class="n">{{ one.n }}</td><td class="n">{{ one.median|percent }}</td>
<td class="n">{{ one.tenth_percentile|percent }}</td>
{% for part in ('median', 'ninetieth_percentile', 'most') %}<td class="n">
{{- '–' if one.remainder_sd[part] is none else one.remainder_sd[part]|number }}</td>{% endfor %}</tr>
{% endfor %}</table>
<p class="note">{{ x.meaning }} {{ x.meaning_of_remainder }}
{% if a.domains_never_tested %}<strong>Domains that no diagnosis tested:
{{ a.domains_never_tested|join(', ') }}.</strong>{% endif %}</p>
"""

AGREEMENT = """<h2>Agreement on a protocol that was not fitted</h2>
<table><tr><th></th><th class="n">before</th><th class="n">after</th><th class="n">noise alone</th>
<th class="n">target</th><th class="n">DukeSim and a scanner</th><th class="n">cases</th></tr>
{% for name, m in s.agreement.metrics.items() %}<tr><td>{{ names[name] }}</td><td class="n">{{ m.before|percent }}</td>
<td class="n">{{ m.after|percent }}</td><td class="n">{{ m.floor|percent }}</td>
<td class="n">{{ m.target|percent if m.target else '' }}</td>
<td class="n">{{ m.dukesim|percent if m.dukesim else '' }}</td>
<td class="n">{{ m.n }} of {{ s.agreement.cases }}</td></tr>{% endfor %}</table>
<p class="note">{{ s.agreement.meaning }} DukeSim: Abadi et al., IEEE Trans. Med. Imaging 38, 1457 (2019).</p>
{% if s.agreement.missing %}<p><strong>Without a held-out protocol:</strong> {{ s.agreement.missing|join(', ') }}
({{ s.agreement.missing|length }} of {{ s.agreement.cases }} cases with one effect).</p>{% endif %}
"""

PARAMETERS = """<h2>Parameters</h2>
{% if s.parameters.parameters %}<table><tr><th>effect</th><th class="n">error, median</th>
<th class="n">in half-widths of its interval</th>
<th>95 % intervals that hold the truth</th></tr>
{% for name, p in s.parameters.by_effect.items() %}<tr><td>{{ name|label }}</td>
<td class="n">{{ p.median_absolute_relative_error|percent }}</td>
<td class="n">{{ '–' if p.median_absolute_half_widths is none else p.median_absolute_half_widths|number }}</td>
<td>{{ p.covered|tally }}</td></tr>{% endfor %}
{% set p = s.parameters.all %}<tr><td><strong>all</strong></td>
<td class="n">{{ p.median_absolute_relative_error|percent }}</td>
<td class="n">{{ '–' if p.median_absolute_half_widths is none else p.median_absolute_half_widths|number }}</td>
<td>{{ p.covered|tally }}</td></tr></table>
<p class="note">{{ s.parameters.meaning }}</p>
{% else %}<p>No named effect has a parameter that can be compared.</p>{% endif %}
"""

CALIBRATION = """<h2>Does what it states of its certainty hold?</h2>
{% for key, title in (('first_named', 'the effect named first'), ('gain', 'gain in log score of every named effect'),
('p', 'p of every named effect'), ('ruled_out', 'effects said to be ruled out'), ('verdict', 'the verdict')) %}
{% if s.calibration[key] %}{% set bare = key in ('verdict', 'ruled_out') %}
<table><tr><th>{{ title }}</th>{% if not bare %}<th class="n">stated at least</th>{% endif %}<th>came true</th>
{% if key == 'first_named' %}<th>it or its equals</th>{% endif %}
<th>in all cases</th></tr>
{% for line in s.calibration[key] %}<tr><td>{{ line.stated }}</td>
{% if not bare %}<td class="n">{{ line.stated_at_least|percent }}</td>{% endif %}
<td{% if line.kept == false %} class="missed"{% endif %}>{{ line.came_true|tally }}</td>
{% if key == 'first_named' %}<td>{{ line.or_stand_in|tally }}</td>{% endif %}
<td>{{ line.with_lacking|tally }}</td></tr>{% endfor %}</table>
<p class="note">{{ s.calibration.meaning[key] }}</p>{% endif %}{% endfor %}
<p class="note">{{ s.calibration.meaning.stated }}</p>
"""

# What a case conceals and what was said of it; `c` is a row of s.cases.
CONCEALED = """{% if c.concealed %}{{ c.concealed|map('label')|join(' and ') }}{% if c.strength %} ({{ c.strength }})
{%- endif %}{% if c.category == 'unknown' %}, which the library lacks{% endif %}{% else %}nothing{% endif %}"""
NAMED = """{% for name in c.named %}{{ name|label }}{% if c.ambiguous_with[name] %} (or
{{ c.ambiguous_with[name]|map('label')|join(', ') }}){% endif %}{{ ', ' if not loop.last }}
{%- else %}nothing{% endfor %}"""

# What was named in a case or a recording, its maps, and its sentence; KEY is where its name stands.
SAID = (
    """<p>Named: <strong>"""
    + NAMED
    + """</strong></p>
<div class="maps">{% for name in ('before', 'after') %}<figure>
<img alt="residuals {{ name }}" src="{{ pictures[c.KEY][loop.index0] }}"><figcaption>{{ name }}</figcaption></figure>
{% endfor %}</div>
<p>{{ c.sentence }}</p>
"""
)

MISSED = (
    """<h2>What was missed, and why</h2>
{% for c in s.cases if not c.right %}{% if loop.first %}
<table><tr><th>case</th><th>concealed</th><th>named</th><th>verdict</th><th>what its numbers say</th></tr>{% endif %}
<tr><td><a href="#{{ c.case }}">{{ c.case }}</a></td><td>"""
    + CONCEALED
    + """</td><td>"""
    + NAMED
    + """</td><td>{{ c.verdict }}</td>
<td>{{ c.why_missed|join(' ') }}</td></tr>{% if loop.last %}</table>{% endif %}
{% else %}<p>Nothing was.</p>{% endfor %}
"""
)

REAL = (
    """{% for c in s.recordings %}{% if loop.first %}<h2>Real recordings</h2>
<p class="note">Nobody knows what these hold, so that they are not scored. Maps as of the cases below.</p>
<div class="cases">{% endif %}
<div class="case" id="{{ c.recording }}" style="border-top-color: {{ c.verdict|colour }}">
<h3>{% if c.recording in reports %}<a href="{{ reports[c.recording] }}">{{ c.recording }}</a>{% else %}
{{- c.recording }}{% endif %}</h3>
"""
    + SAID.replace("KEY", "recording")
    + """<p>Root mean square beyond noise removed on data not fitted: {{ c.excess_rms_removed|percent }}</p>
{% for caveat in c.caveats %}<p class="note">{{ caveat }}</p>{% endfor %}
</div>{% if loop.last %}</div>{% endif %}{% endfor %}
"""
)

GALLERY = (
    """<h2>Every case</h2>
<p class="note">Maps: recorded less modelled on data not fitted, from −{{ limit|number }} (blue) to {{ limit|number }}
(red) standard deviations in all of them. Projections: views down, detector columns across;
images: rows and columns.</p>
<div class="cases">{% for c in s.cases %}
<div class="case" id="{{ c.case }}" style="border-top-color: {{ c.verdict|colour }}">
<h3>{% if c.case in reports %}<a href="{{ reports[c.case] }}">{{ c.case }}</a>{% else %}{{ c.case }}{% endif %}
<span class="{{ 'reached' if c.right else 'missed' }}">{{ 'right' if c.right else 'missed' }}</span></h3>
<p>{{ c.phantom|label }}, {{ c.kind }}</p>
<p>Concealed: <strong>"""
    + CONCEALED
    + """</strong></p>
"""
    + SAID.replace("KEY", "case")
    + """{% if not c.held_out_protocol %}
<p class="note">There is no table of agreement on another protocol.</p>{% endif %}
</div>{% endfor %}</div>
"""
)
