"""Report of a study: one file with every figure, table and diagnosis; tables can be sorted and filtered."""

import base64
import hashlib
import io
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from browser import opened, outside_resources
from markupsafe import escape
from PIL import Image
from resolved import resolved
from robust_study import robustness_table

from virtual_phantom.report import study
from virtual_phantom.report.methods import how_to_report

VOID = {"meta", "img", "input", "br", "link"}
CONFIG = resolved("paper_groups.yaml") | {"results_dir": "r <1>"}
CONFIG["statistics"] = CONFIG["statistics"] | {"threshold": 1.5}
STABLE = pd.DataFrame(
    {
        "feature": ["original_glcm_Idn", "original_firstorder_Mean", "original_glszm_ZoneEntropy"],
        "value": [0.00012345, 300.0, np.nan],
        "rank": [10, 9, 2],
        "stable": ["no", "yes", "undefined"],
    }
)


class Balanced(HTMLParser):
    """Parser that fails on unbalanced tags and collects ids and internal links."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links = [], [], []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in VOID:
            self.open.append(tag)
        self.ids += filter(None, [attributes.get("id")])
        self.links += filter(None, [attributes.get("href")])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    (folder / "tables").mkdir()
    picture = io.BytesIO()
    Image.new("RGB", (40, 30), "red").save(picture, "png")
    (folder / "rois.png").write_bytes(picture.getvalue())
    (folder / "rois.rst").write_text(
        "**Regions** \\|W\\| < {{ snakemake.params.threshold }} of {{ snakemake.wildcards.recording }}, "
        'seed {{ snakemake.config.get("seed") }}.\n'
    )
    STABLE.to_csv(folder / "tables" / "stable_features.csv", index=False)
    pd.DataFrame({"x": range(study.MOST_ROWS + 1)}).to_csv(folder / "tables" / "long.csv", index=False)
    (folder / "report.html").write_text('<!doctype html><p class="v">Verdict "of" <b>ours</b></p>')
    return folder


@pytest.fixture(scope="module")
def page(files):
    figure = study.ReportFigure(
        files / "rois.png", "Phantom", "Regions <1>", files / "rois.rst", {"threshold": 1.5}, {"recording": "a <b>"}
    )
    robustness_table().to_csv(files / "tables" / "trust.csv", index=False)
    names = {"Stable features": "stable_features", "Long": "long", "Trust": "trust"}
    tables = {title: files / "tables" / f"{name}.csv" for title, name in names.items()}
    return study.report_page([figure], tables, {"disc": files / "report.html"}, {"Slices": "viewer.html"}, CONFIG)


def test_report_is_one_well_formed_file(page):
    parser = Balanced()
    parser.feed(page)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids))
    inside = [link[1:] for link in parser.links if link.startswith("#")]
    assert set(inside) <= set(parser.ids) and {"tables", "provenance", "diagnoses", "Phantom"} <= set(inside)
    assert outside_resources(page) == []


def test_figures_captions_and_diagnoses_are_included(page, files):
    picture = re.search(r'src="data:image/png;base64,([^"]+)"', page)[1]
    assert base64.b64decode(picture) == (files / "rois.png").read_bytes()
    assert "<strong>Regions</strong> |W| &lt; 1.5 of a &lt;b&gt;, seed 2022." in page
    assert "Regions &lt;1&gt;" in page and "<b>ours" not in page
    assert "&lt;p class=&#34;v&#34;&gt;Verdict &#34;of&#34; &lt;b&gt;ours&lt;/b&gt;" in page


def test_provenance_is_included(page, files):
    for path in (files / "tables").iterdir():
        assert hashlib.sha256(path.read_bytes()).hexdigest() in page
    assert f"numpy\n{np.__version__}" in page
    assert "threshold: 1.5" in page and "results_dir: r &lt;1&gt;" in page


def test_text_for_a_methods_section_is_included(page):
    text = how_to_report(CONFIG, study.packages(), study.__version__)
    assert "|W| < 1.5" in text and f"<blockquote>{escape(text)}</blockquote>" in page


def test_long_tables_are_linked(page):
    assert "This table is too long for the page." in page and 'href="tables/long.csv"' in page
    assert page.count("<tbody>") == 2  # for the short table, and for the table of checksums


def test_use_of_each_feature_replaces_the_rows_of_trust(page):
    box = page[page.index('id="table-trust"') : page.index('id="provenance"')]
    assert "20 rows" in box and 'href="tables/trust.csv"' in box and "<tbody>" not in box.partition('id="diagnoses"')[0]
    assert "Robust for every change" in box and "<b>First order Entropy.</b> Not robust for dose." in box


@pytest.mark.parametrize(
    "value, text, key, number",
    [
        ("original_glcm_Idn", "GLCM Idn", "original_glcm_Idn", False),
        (0.00012345, "1.2e-04", "0.00012345", True),
        (12.3456, "12.3", "12.3456", True),
        (7, "7", "7.0", True),
        (50.0, "50", "50.0", True),
        (float("nan"), "", "", True),
    ],
)
def test_cells_are_rounded_and_sorted_by_their_full_values(value, text, key, number):
    assert study.cell(value) == {"text": text, "key": key, "n": number}


SORT = """
const box = document.querySelector("#table-stable_features"), heads = [...box.querySelectorAll("th button")];
const rows = () => [...box.querySelectorAll("tbody tr")];
const features = () => rows().filter((row) => !row.hidden).map((row) => row.cells[0].textContent);
const found = {start: features()};
heads[2].click(); found.rank = features(); found.aria = heads[2].parentElement.getAttribute("aria-sort");
heads[2].click(); found.down = features();
heads[1].click(); found.value = features(); heads[1].click(); found.value_down = features();
heads[0].click(); found.name = features(); found.old = heads[1].parentElement.hasAttribute("aria-sort");
const filter = box.querySelector("input");
const tried = [["glcm", "GLCM"], ["words", "undefined zone"], ["raw", "original_firstorder"], ["none", "xyz"]];
for (const [name, text] of tried) {
  filter.value = text; filter.dispatchEvent(new Event("input")); found[name] = features();
}
found.count = box.querySelector("output").textContent;
found.picture = document.images[0].naturalWidth;
found.wider = document.documentElement.scrollWidth > innerWidth;
return found;
"""


@pytest.mark.parametrize("width", [1280, 390])
def test_tables_sort_and_filter_in_a_browser(page, tmp_path, width):
    found = opened(page, tmp_path, SORT, width)
    idn, mean, zone = "GLCM Idn", "First order Mean", "GLSZM ZoneEntropy"
    assert found["start"] == [idn, mean, zone]
    assert found["rank"] == [zone, mean, idn] and found["aria"] == "ascending"
    assert found["down"] == [idn, mean, zone]
    # Numerical order, with empty cells last in either direction.
    assert found["value"] == [idn, mean, zone] and found["value_down"] == [mean, idn, zone]
    assert found["name"] == [mean, idn, zone] and found["old"] is False
    assert found["glcm"] == [idn] and found["words"] == [zone] and found["raw"] == [mean] and found["none"] == []
    assert found["count"] == "0 of 3 rows"
    assert found["picture"] == 40 and found["wider"] is False


def test_trial_is_labeled(page):
    words = "too small for meaningful results"
    assert words in study.report_page([], {}, {}, {}, CONFIG | {"trial": True}) and words not in page
