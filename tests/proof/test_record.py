"""Record of the blind validation: pooled seeds, added scores, and coverage of intervals."""

import re
import runpy
import sys
from html import unescape
from pathlib import Path

import pytest
import yaml
from generators import validation_tables
from proof_suite import diagnosis, write_suite

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.names import enumerated, label
from virtual_phantom.physics.effect import load, names
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.case import collect
from virtual_phantom.proof.hiding.catalogue import MODELS, never_hidden
from virtual_phantom.proof.scoring.record import add, coverage_table, summary
from virtual_phantom.proof.scoring.score import score
from virtual_phantom.report.html import render_diagnosis
from virtual_phantom.report.proof import percent
from virtual_phantom.statistics.proof_record import (
    IntervalCoverage,
    interval_coverage,
    pooled_counts,
    read_proof_record,
    with_coverage,
)

ROOT = Path(__file__).resolve().parents[2]
RECORD = RESOURCES / "proof_record.yaml"
COUNTS = {
    "first_medium_or_strong": [3, 4],
    "first_weak": [1, 2],
    "pairs": [2, 4],
    "false_alarms": [0, 3],
    "unknown": [1, 3],
    "exact": [5, 9],
    "intervals": [6, 10],
}


def entry(seed, unseen=True, coverage=(), **changed):
    found = {"seed": seed, "unseen": unseen, "state": "a", "note": "n", "cases": 9, "counts": COUNTS | changed}
    return found | {"coverage": [{"effects": list(effects), "held": list(pair)} for effects, pair in coverage]}


@pytest.fixture
def record(tmp_path):
    """Function that writes entries."""

    def written(*entries):
        (tmp_path / "record.yaml").write_text("# seeds\n" + yaml.safe_dump(list(entries)))
        return tmp_path / "record.yaml"

    return written


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return score(collect(**write_suite(tmp_path_factory.mktemp("suite"))), suite={"seed": 14})


def test_unseen_seeds_are_pooled(record):
    seeds = read_proof_record(record(entry(1, unseen=False), entry(2), entry(3, pairs=[4, 4])))
    assert pooled_counts(seeds)["pairs"] == (6, 8) and pooled_counts(seeds)["intervals"] == (12, 20)
    share = summary(seeds)["pooled"]["intervals"]
    # Wilson: center (12 + 1.92) / (20 + 3.84), half-width 1.96 / 23.84 * sqrt(12 * 8 / 20 + 0.96)
    assert share["ci95"] == pytest.approx([0.3866, 0.7812], abs=2e-4)
    assert summary(seeds)["pooled_seeds"] == [2, 3] and len(summary(seeds)["seeds"]) == 3


def test_shipped_record_agrees_with_the_docs_for_three_seeds():
    entries = [one for one in read_proof_record(RECORD) if one.seed in (11, 12, 13)]
    assert pooled_counts(entries) == {
        "first_medium_or_strong": (109, 114),
        "first_weak": (42, 57),
        "pairs": (28, 36),
        "false_alarms": (1, 24),
        "unknown": (18, 24),
        "exact": (185, 231),
        "intervals": (121, 224),
    }
    assert {one.seed for one in read_proof_record(RECORD) if not one.unseen} >= {1, 2022}


def test_coverage_is_that_of_the_effect_or_of_the_smallest_group(record):
    both = (("motion", "scatter"), (3, 4))
    path = record(
        entry(1, unseen=False, coverage=[(("scatter",), (9, 9))]),
        entry(2, coverage=[both, (("heel",), (0, 1))]),
        entry(3, coverage=[both, (("scatter",), (1, 2))]),
    )
    assert interval_coverage(read_proof_record(path), "scatter") == IntervalCoverage(("motion", "scatter"), 4, 6)
    assert (
        interval_coverage(read_proof_record(path), "heel") == IntervalCoverage(("heel",), 0, 1)
        and interval_coverage(read_proof_record(path), "bowtie") is None
    )


def test_diagnosis_states_the_coverage_of_each_interval(record):
    entries = read_proof_record(record(entry(2, coverage=[(("scatter",), (1, 4))])))
    values = {"scatter": {"amount": (0.1, 0.0, 0.2)}, "motion": {"x_mm": (1.0, 0.9, 1.1)}}
    text = with_coverage(diagnosis("a", "mismatch explained", values), entries)
    first, second = (effect["parameters"] for effect in text["effects"])
    whole = {"count": 6, "n": 10}
    assert first["amount"]["ci95_held"] == {"count": 1, "n": 4, "effects": ["scatter"], "all": whole}
    assert first["amount"]["ci95"] == [0.0, 0.2] and second["x_mm"]["ci95_held"]["count"] is None
    texts = [render_diagnosis("parameters", text, e=effect) for effect in text["effects"]]
    assert (
        "covered the true values of 1 of 4 parameters of scatter and of 6 of 10 parameters of all effects."
        in unescape(texts[0])
    )
    assert "of 6 of 10 parameters of all effects (none of this effect were tested)." in unescape(texts[1])
    plain = diagnosis("a", "mismatch explained", values)["effects"][0]
    assert "covered the true values" not in render_diagnosis("parameters", text, e=plain)


def test_score_is_added_once_below_the_existing_ones(record, found):
    path = record(entry(11))
    before = path.read_text()
    add(path, found, "abc1234", "after a change")
    assert path.read_text().startswith(before)
    first, second = read_proof_record(path)
    assert (second.seed, second.cases, second.unseen, second.state) == (14, 9, True, "abc1234")
    assert second.counts["exact"] == (3, 7) and second.counts["intervals"] == (1, 2)
    assert interval_coverage([second], "scatter") == IntervalCoverage(("scatter",), 1, 2)
    assert pooled_counts([first, second])["first_medium_or_strong"] == (4, 6)
    with pytest.raises(InputError, match="record.yaml: already has seed 14"):
        add(path, found, "abc1235", "again")
    with pytest.raises(InputError, match="the score: is not valid"):
        add(path, {"counts": {}}, "abc1235", "again")


def test_from_the_command_line(record, found, tmp_path, capsys, monkeypatch):
    path = record(entry(11))
    seal.write(found, tmp_path / "score.json")

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["proof_record.py", "--record", str(path), *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(ROOT / "workflow/scripts/proof_record.py"), run_name="__main__")
        return ended.value.code, capsys.readouterr()

    code, text = run("add", tmp_path / "score.json", "--state", "abc1234", "--note", "n")
    assert (
        code == 0 and "seeds 11, 14" in text.out and "two effects: both named: 3 of 6" in text.out.replace("\xa0", " ")
    )
    code, text = run("add", tmp_path / "score.json", "--state", "abc1234", "--note", "n")
    assert code == 1 and text.err.startswith("Error: ") and text.err.count("\n") == 1
    code, text = run("rows", tmp_path / "score.json")
    table = text.out.splitlines()
    assert code == 0 and {line.count("|") for line in table} == {5}
    assert "| both of two effects named | 1 of 2 (50 %; 9.5 to 91 %) | at least 75 % | **missed** |" in table
    wrong = "held-out excess removed, median and tenth percentile: an effect named that is not hidden"
    assert f"| {wrong} | 65 %, 53 % of 4 cases |  |  |" in table
    assert run("pooled")[0] == 0
    code, text = run("coverage", tmp_path / "score.json", tmp_path / "score.json")
    assert code == 0 and "seed 14" in text.out


def test_coverage_of_two_scores_in_one_table(found):
    other = score([], suite={"seed": 13})
    lines = [line.split() for line in coverage_table(found, other)]
    assert lines[0][-4:] == ["seed", "14", "seed", "13"]
    assert ["scatter", "1", "of", "2", "-"] in lines and ["all", "1", "of", "2", "-"] in lines


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([entry(1), entry(1)], "has seed 1 twice"),
        ([entry(1, pairs=[3, 2])], "is not a count and its total"),
        ([entry(1) | {"counts": {"pairs": [1, 2]}}], "seed 1 needs the counts"),
        ([entry(1) | {"unseen": "perhaps"}], "neither true nor false"),
        ([{"seed": 1}], "is not a record of the blind validation"),
    ],
)
def test_broken_record_is_one_line(record, entries, message):
    with pytest.raises(InputError, match=f"record.yaml: .*{message}"):
        read_proof_record(record(*entries))


def test_readme_has_the_pooled_counts():
    readme = (ROOT / "README.md").read_text()
    for name, share in summary(read_proof_record(RECORD))["pooled"].items():
        assert name == "exact" or f"{share['count']} of {share['n']} ({percent(share['share'])}; " in readme, name


def test_docs_have_the_pooled_counts():
    """After a seed is added to the record, the page must be updated."""
    page = " ".join((ROOT / "docs/validation/blind-validation.md").read_text().split())
    shown = summary(read_proof_record(RECORD))
    for name, share in shown["pooled"].items():
        assert f"| {share['count']} of {share['n']} ({percent(share['share'])}; " in page, name
    named = re.search(r"Unseen seeds ([^:]*), as first scored", page)[1]
    named = re.sub(r"\([^)]*\)", "", named)  # numbers of cases
    assert [int(number) for number in re.findall(r"\d+", named)] == shown["pooled_seeds"]
    others = re.search(r"\*\*Not counted\*\*: ([^.]*)", page)[1]
    assert {seed["seed"] for seed in shown["seeds"]} - set(shown["pooled_seeds"]) <= set(
        map(int, re.findall(r"\d+", others))
    )


def test_pages_state_the_number_of_effects():
    """All numbers that change with a new effect."""
    known, all_ = len(names()) - len(never_hidden()), len(names())
    never = enumerated([load(name).display_name for name in never_hidden()])
    stated = {
        "README.md": (f"It also fits {all_} physical effects", f"In all, {known} of the {all_} effects are hidden."),
        "docs/validation/blind-validation.md": (f"{known} of the library's {all_} effects. Never hidden are {never}.",),
    }
    pages = {path: " ".join((ROOT / path).read_text().split()) for path in stated}
    missing = [f"{path}: write {text!r}" for path, texts in stated.items() for text in texts if text not in pages[path]]
    assert not missing, "\n".join(missing)


def test_docs_count_the_seed_that_was_scored_last_and_the_worst():
    page = (ROOT / "docs/validation/blind-validation.md").read_text()
    entries = [one for one in read_proof_record(RECORD) if one.unseen and one.counts]
    for name, (count, n) in pooled_counts(entries).items():
        (row,) = [line for line in page.splitlines() if f"| {count} of {n} (" in line]
        pairs = [entry.counts[name] for entry in entries]
        worst = (max if name == "false_alarms" else min)(pairs, key=lambda pair: pair[0] / pair[1])
        assert row.endswith("".join(f"| {one} of {of} " for one, of in (pairs[-1], worst)) + "|"), row


def test_docs_state_the_origin_of_the_equations():
    page = validation_tables.page()
    for model, made in MODELS.items():
        known, lacking = (", ".join(label(one) for one in made if (one in names()) == kind) for kind in (True, False))
        assert f"| {model} | {known} | {lacking} |" in page


def test_generated_page_has_every_seed_and_every_table():
    page = validation_tables.page()
    for name, share in summary(read_proof_record(RECORD))["pooled"].items():
        assert f"| {share['count']} of {share['n']} ({percent(share['share'])}; " in page, name
    for entry in read_proof_record(RECORD):
        assert f"Seed {entry.seed}" in page and all(f"| {a} of {b} |" in page for a, b in entry.counts.values())
    results = yaml.safe_load(validation_tables.RESULTS.read_text())
    titles = [table["name"] for section in results for table in section["tables"]]
    assert len(set(titles)) == len(titles) and all(f"\n### {title}\n" in page for title in titles)
    with pytest.raises(ValueError, match="has 1 cells; the header has 2"):
        validation_tables.table(["a", "b"], [["c"]])
