"""Outputs quoted on pages are those of the program, or are listed below with the reason why they are not compared."""

import re
from pathlib import Path

import pytest
from pages import blocks

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.study.costs.rates import read_rates
from virtual_phantom.study.costs.table import cost_summary, plan_text
from virtual_phantom.study.progress.failures import without_reason

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
QUOTE = re.compile(r"(?:^ *> .*\n)+", re.MULTILINE)
FENCED = re.compile(r"(?P<mark><!-- .* -->\n)?^ *```text\n(?P<text>.*?)^ *```$", re.MULTILINE | re.DOTALL)
# Pages whose blocks are formulas.
WITHOUT = {"theory.md", "statistics.md"}
# First words of a quotation: the test that compares it, or why none does.
UNCHECKED = {
    "15:39:47 Jobs to do": "times of one run; the form is that of tests/progress/test_console.py",
    "phantom -> project": "a drawing",
}
CHECKED = {
    "solid_disc: mismatch partly explained": "test_readme_quotes_the_output_of_the_guide",
    "Failed: phantom of": "test_line_of_a_killed_script_is_quoted_correctly",
    "1760 acquisitions": "test_plan_of_a_large_study_is_quoted_correctly",
}


def words(text):
    return " ".join(text.split())


def quoted(text, printed):
    """Whether all parts of a quotation, between [...] or ..., occur in this order in the output."""
    parts = [re.escape(words(part)) for part in re.split(r"\[\.\.\.\]|\.\.\.", text)]
    return re.search(".*?".join(parts), words(printed)) is not None


def quotations(path):
    return [words(re.sub(r"^ *> ?", "", one, flags=re.MULTILINE)) for one in QUOTE.findall(path.read_text())]


def test_readme_quotes_the_output_of_the_guide():
    """tests/workflow/test_marked_pages.py compares the guide's output with its command."""
    (quote,) = [one["text"] for one in FENCED.finditer((ROOT / "README.md").read_text()) if "solid_disc" in one["text"]]
    printed = [block.text for block in blocks(DOCS / "getting-started" / "own-sinogram.md") if block.kind == "prints"]
    assert any(quoted(quote, one) for one in printed), quote


def test_plan_of_a_large_study_is_quoted_correctly(monkeypatch):
    monkeypatch.chdir(ROOT)
    lines, settings = read_configs(["config/large.yaml"])
    assert not lines
    printed = plan_text(*cost_summary(Plan(read_study(settings)), "cpu", read_rates(RESOURCES / "rates.yaml")))
    page = (DOCS / "how-to" / "cluster.md").read_text()
    (text,) = [one["text"] for one in FENCED.finditer(page) if "1760" in one["text"]]
    assert quoted(text, printed), printed


def test_line_of_a_killed_script_is_quoted_correctly():
    files = [f"results/phantom/{name}" for name in ("image.nii.gz", "labels.nii.gz", "rois.csv", "rois.npz")]
    job = {"rule_name": "phantom", "jobid": 1, "output": files, "log": ["results/logs/phantom.log"]}
    (line,) = without_reason([job], message="died with <Signals.SIGKILL: 9>.").values()
    page = (DOCS / "explanation" / "how-it-works.md").read_text()
    (text,) = [one["text"] for one in FENCED.finditer(page) if "SIGKILL" in one[0]]
    assert words(text) == line


@pytest.mark.parametrize("path", [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))], ids=lambda path: path.name)
def test_every_quoted_output_is_compared_or_has_a_reason(path):
    text = path.read_text(encoding="utf-8")
    found = quotations(path)
    if path.name not in WITHOUT:
        found += [words(one["text"]) for one in FENCED.finditer(text) if not one["mark"]]
    known = (*UNCHECKED, *CHECKED)
    assert not [one for one in found if not one.startswith(known)]


def test_parts_of_quotations_occur_in_order():
    assert quoted("one two [...] five", "one  two three four five six")
    assert quoted("one ... three\n...\nsix", "one two three four five six")
    assert not quoted("five [...] one two", "one two three four five six")
    assert not quoted("one ... two ... nine", "one two three four five six")
    assert not quoted("one three", "one two three")
