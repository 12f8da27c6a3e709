"""The table of agreement for the report."""

from __future__ import annotations

from jinja2 import Environment

from ..figures import style

ALGORITHMS = {"fbp": "filtered back-projection", "sirt": "SIRT"}
NAMES = {
    "contrast": "contrast",
    "noise_magnitude": "noise magnitude (SD)",
    "noise_texture": "noise texture (mean frequency)",
    "noise_spectrum": "noise spectrum's shape (RMS)",
    "resolution": "resolution (frequency at MTF 0.5)",
    "features": "features within a repeat SD",
}
TABLE = """{% if table.metrics %}
<table><tr><th>in reconstructed images</th><th>recorded</th><th>before</th><th>after</th><th>noise alone</th></tr>
{% for name, m in table.metrics.items() %}<tr><td>{{ names[name] }}</td><td class="n">{{ m.recorded|quantity(m.unit) }}
</td><td class="n">{{ m.before|compared(m.unit) }}</td><td class="n">{{ m.after|compared(m.unit) }}</td>
<td class="n">{{ m|floor }}</td></tr>
{% endfor %}</table>
<p class="note">{{ table.repeats }} recorded and as many simulated scans, by {{ table.algorithm|algorithm }} onto
{{ table.grid.shape[2] }} × {{ table.grid.shape[1] }} × {{ table.grid.shape[0] }} voxels of
{{ table.grid.spacing_mm[2]|short }} × {{ table.grid.spacing_mm[1]|short }} × {{ table.grid.spacing_mm[0]|short }} mm.
Contrasts are of {{ table.rois|join(', ')|replace('_', ' ') }}. In brackets: simulated against recorded. Noise alone:
standard error of that difference after; of spectra the difference, of features the share that is expected where
nothing but noise differs.</p>{% endif %}
{% for name, reason in table.left_out.items() %}<p class="note">
{{ 'Images were not compared' if name == 'images' else 'Not measured in images: ' ~ names[name] }} ({{ reason }}).</p>
{% endfor %}"""


def agreement_table(table: dict | None) -> str:
    """What agreement.agreement found, with rois, repeats and grid, as HTML; nothing for None."""
    if table is None:
        return ""
    environment = Environment(autoescape=True)
    environment.filters |= {
        "quantity": _quantity,
        "compared": _compared,
        "floor": _floor,
        "short": style.number,
        "algorithm": lambda name: ALGORITHMS[name],
    }
    return environment.from_string(TABLE).render(table=table, names=NAMES)


def _quantity(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    return f"{100 * value:.0f} %" if unit == "share" else f"{style.number(value)} {unit}"


def _compared(column: dict, unit: str) -> str:
    value, relative = _quantity(column["value"], unit), column["relative_difference"]
    if relative is None:
        return value
    difference = f"{style.number(100 * relative)} %"
    return f"{value} ({difference})" if value else difference


def _floor(metric: dict) -> str:
    if metric["floor"] is None:
        return ""
    if metric["unit"] == "share":
        return f"{100 * metric['floor']:.0f} %"
    signed = "±" if metric["recorded"] is not None else ""
    return f"{signed}{style.number(100 * metric['floor'])} %"
