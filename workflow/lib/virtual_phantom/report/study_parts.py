"""Template and script of the study's report: figures, tables that sort and filter, pages, provenance."""

from .html import STYLE

MORE_STYLE = """body { max-width: 72rem; margin: 0 auto; padding: 0 1rem 3rem; }
nav { position: sticky; top: 0; background: #fff; border-bottom: 1px solid #ddd; padding: .5rem 0; z-index: 2;
display: flex; flex-wrap: wrap; gap: .1rem 1rem; font-size: .92rem; }
h2, h3 { scroll-margin-top: 4.5rem; } h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
figure { margin: 0 0 1.5rem; } figcaption { font-size: .9rem; color: #444; max-width: 60rem; }
figcaption p { margin: .4rem 0; } figure img { display: block; margin: 0 auto; }
details { border: 1px solid #ddd; border-radius: 4px; margin: .5rem 0; padding: .35rem .7rem; }
summary { cursor: pointer; font-weight: 600; } summary .note { font-weight: 400; }
.scroll { overflow: auto; max-height: 32rem; margin: .4rem 0; }
.scroll table { margin: 0; font-size: .85rem; } .scroll td, .scroll th { padding: .2rem .8rem .2rem 0;
white-space: nowrap; }
.scroll th { position: sticky; top: 0; background: #fff; vertical-align: bottom;
white-space: normal; min-width: 3.5rem; }
.scroll th button { font: inherit; font-weight: 600; background: none; border: 0; padding: 0; cursor: pointer;
text-align: left; color: #0072B2; }
.scroll th[aria-sort=ascending] button::after { content: " \\25B2"; }
.scroll th[aria-sort=descending] button::after { content: " \\25BC"; }
input[type=search] { font: inherit; width: min(100%, 22rem); padding: .2rem .4rem; box-sizing: border-box; }
iframe { width: 100%; height: 40rem; border: 1px solid #ddd; } pre { overflow: auto; font-size: .8rem; }
code { overflow-wrap: anywhere; font-size: .85em; }
td.yes { color: #007355; font-weight: 600; } td.no { color: #8a8a8a; }
@media (max-width: 40rem) { .scroll td:first-child { white-space: normal; overflow-wrap: anywhere; min-width: 7rem; } }
@media print { nav { display: none; } .scroll { max-height: none; } }
"""

BODY = """<h1>Report of the study</h1>
<p class="note">Simulated CT scans of a phantom, their reconstructions, and which radiomics features to trust.
{% for text, address in links.items() %}<a href="{{ address }}">{{ text }}</a>{{ ", " if not loop.last else "." }}
{% endfor %}</p>
<nav>{% for section in sections %}<a href="#{{ section|replace(' ', '-') }}">{{ section }}</a>
{% endfor %}<a href="#tables">Tables</a>{% if embedded %}
<a href="#diagnoses">Diagnoses</a>{% endif %}
<a href="#provenance">Provenance</a></nav>
{% for section, figures in sections.items() %}<h2 id="{{ section|replace(' ', '-') }}">{{ section }}</h2>
{% for one in figures %}<figure id="{{ one.name }}"><h3>{{ one.title }}</h3>
<img alt="{{ one.title }}" src="{{ one.picture }}">
<figcaption>{{ one.caption|safe }}<p><a href="figures/{{ one.name }}.pdf">as PDF</a></p></figcaption></figure>
{% endfor %}{% endfor %}
<h2 id="tables">Tables</h2>
<p class="note">A heading sorts by its column, once more turns the order. The filter keeps the rows that hold all
of its words. Numbers are rounded here; the files beside this page hold them in full, as CSV and Parquet.</p>
{% for table in tables %}<details id="table-{{ table.name }}"{{ ' open' if loop.first }}><summary>{{ table.title }}
<span class="note">{{ table.frame|length }} rows, {{ table.frame.columns|length }} columns</span></summary>
{% if table.shown %}<p><input type="search" placeholder="filter" aria-label="filter {{ table.title }}">
<output class="note"></output></p>
<div class="scroll"><table><thead><tr>{% for name in table.frame.columns %}<th scope="col"><button type="button">
{{- name|heading }}</button></th>{% endfor %}</tr></thead><tbody>
{% for row in table.frame.itertuples(index=False, name=None) %}<tr>{% for value in row %}{% set c = value|cell -%}
<td{% if c.n %} class="n"{% elif c.text in ("yes", "no") %} class="{{ c.text }}"{% endif %}
{%- if c.key != c.text %} data-key="{{ c.key }}"{% endif %}>{{ c.text }}</td>{% endfor %}</tr>
{% endfor %}</tbody></table></div>{% else %}<p>Too long to be shown here.</p>{% endif %}
<p><a href="{{ 'features' if table.name == 'features' else 'tables/' + table.name }}.csv">{{ table.name }}.csv</a></p>
</details>
{% endfor %}
{% if embedded %}<h2 id="diagnoses">Diagnoses</h2>
{% for title, text in embedded.items() %}<details><summary>{{ title }}</summary>
<iframe title="{{ title }}" sandbox srcdoc="{{ text }}"></iframe></details>
{% endfor %}{% endif %}
<h2 id="provenance">Provenance</h2>
<p>Virtual Phantom {{ version }}, Python {{ python }}; {% for name, number in packages.items() %}{{ name }}
{{ number }}{{ ", " if not loop.last else "." }}
{% endfor %}</p>
<details><summary>Checksums <span class="note">SHA-256 of the tables</span></summary>
<div class="scroll"><table><tbody>{% for path, digest in checksums.items() %}<tr><td>{{ path }}</td>
<td><code>{{ digest }}</code></td></tr>{% endfor %}</tbody></table></div></details>
<details><summary>Configuration <span class="note">complete, defaults filled in</span></summary>
<pre>{{ config }}</pre></details>
"""

SCRIPT = """"use strict";
for (const box of document.querySelectorAll("details")) {
  const table = box.querySelector("thead") && box.querySelector("table");
  if (!table) continue;
  const body = table.tBodies[0], rows = [...body.rows];
  const filter = box.querySelector("input"), count = box.querySelector("output");
  const key = (row, column) => row.cells[column].dataset.key ?? row.cells[column].textContent;
  filter.addEventListener("input", () => {
    const words = filter.value.toLowerCase().split(/\\s+/);
    let left = 0;
    for (const row of rows) {
      const texts = [...row.cells].map((cell) => cell.textContent + " " + (cell.dataset.key ?? ""));
      const text = texts.join(" ").toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      left += !row.hidden;
    }
    count.textContent = filter.value ? left + " of " + rows.length + " rows" : "";
  });
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending", sign = down ? -1 : 1;
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const numbers = rows.every((row) => row.cells[column].classList.contains("n"));
    const compare = numbers ? (a, b) => a - b : (a, b) => a.localeCompare(b, "en", {numeric: true});
    body.append(...[...rows].sort((one, other) => {
      const a = key(one, column), b = key(other, column);
      // What is empty stays last.
      if (a === "" || b === "") return (a === "") - (b === "");
      return sign * compare(a, b);
    }));
  }));
}
document.body.dataset.ready = "yes";
"""

PAGE = (
    """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Report of the study</title>
<style>
"""
    + STYLE
    + MORE_STYLE
    + "</style></head><body>\n"
    + BODY
    + "<script>\n"
    + SCRIPT
    + "</script>\n"
)
