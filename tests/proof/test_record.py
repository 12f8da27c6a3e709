"""Record of the blind validation: registered runs, filled pages, and coverage of intervals."""

import errno
import json
import os
import runpy
import sys
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from generators import proof_confusion, validation_tables
from proof_suite import TRUTHS, diagnosis, write_suite

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.names import label
from virtual_phantom.config.config import read_study
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.io.files import DISK_PROBLEMS
from virtual_phantom.physics.effect import names
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.catalogue import MODELS, never_hidden
from virtual_phantom.proof.hiding.hidden_effect import EQUATIONS
from virtual_phantom.proof.scoring import registration
from virtual_phantom.proof.scoring.collect import collect
from virtual_phantom.proof.scoring.record import coverage_table, filled, table_of
from virtual_phantom.proof.scoring.score import score
from virtual_phantom.report.html import render_diagnosis
from virtual_phantom.statistics.proof_record import read_proof_record, with_coverage
from virtual_phantom.study.benchmark import Benchmark
from virtual_phantom.study.checks.preflight import problems

ROOT = Path(__file__).resolve().parents[2]
RECORD = RESOURCES / "proof_record.yaml"
PAGES = ("README.md", "docs/validation/blind-validation.md")
COMMIT = "0123456789abcdef0123456789abcdef01234567"
SEED = 0x01234567
SETTINGS = {"seed": SEED, "strengths": ("weak", "strong")}
CASES = [one["case"] for one in TRUTHS]
COUNTS = {"first_medium_or_strong": [3.5, 4], "false_alarms": [0, 3], "intervals": [6, 10]}


def entry(commit, coverage=None, **changed):
    found = {"seed": 1, "commit": commit, "rule": 2, "cases": 9, "note": "n"}
    return found | {"counts": COUNTS | changed, "coverage": coverage or {}}


def assessed(folder, cases=CASES, settings=SETTINGS):
    """Registration of a folder at its score."""
    registered = seal.read(folder / "registration.json")
    return registration.assessed(registered, folder / "seals.json", folder / "runs.jsonl", cases, settings)


@pytest.fixture
def record(tmp_path):
    """Function that writes entries."""

    def written(*entries):
        (tmp_path / "record.yaml").write_text("# runs\n" + yaml.safe_dump(list(entries)))
        return tmp_path / "record.yaml"

    return written


@pytest.fixture
def committed(monkeypatch):
    """A clean checkout of COMMIT; returns the list of changed files."""
    changed = []
    monkeypatch.setattr(registration, "commit", lambda: COMMIT)
    monkeypatch.setattr(registration, "changed_files", lambda: changed)
    return changed


@pytest.fixture
def run(tmp_path, committed):
    """Folder of a registered and scored run."""
    folder = tmp_path / "proof"
    files = write_suite(folder)
    registered = registration.registration(SETTINGS, TRUTHS, files["seals"])
    seal.write(registered, folder / "registration.json")
    for event in ("registered", "failed", "resumed"):
        registration.log_run(folder / "runs.jsonl", event, registered)
    found = score(collect(**files), suite={"seed": 14}, registration=assessed(folder))
    seal.write(found, folder / "score.json")
    return folder


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Function that runs proof_record.py on copies of the pages."""
    for page in PAGES:
        (tmp_path / page).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / page).write_text((ROOT / page).read_text())

    def run(path, *words):
        options = ("--record", str(path), "--root", str(tmp_path))
        monkeypatch.setattr(sys, "argv", ["proof_record.py", *options, *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(ROOT / "workflow/scripts/proof_record.py"), run_name="__main__")
        return ended.value.code, capsys.readouterr()

    return run


def test_seed_is_derived_from_the_commit(committed, monkeypatch):
    assert registration.seed_of("commit") == SEED and registration.seed_of(16) == 16
    stated = read_configs([ROOT / "config/quick_proof.yaml"])[1] | {"proof": {"seed": "commit"}}
    assert read_study(stated).proof.seed == SEED
    monkeypatch.setattr(registration, "commit", lambda: None)
    assert problems(stated) == ["proof.seed: 'commit' needs a Git checkout of Virtual Phantom; use a whole number"]


def test_this_checkout_has_a_commit():
    """In an archive without Git, there is none."""
    found = registration.commit()
    assert (found is None) == (not (ROOT / ".git").exists()) and (found is None or len(found) == 40)


def test_changed_code_is_refused_or_recorded(tmp_path, committed):
    files = write_suite(tmp_path)
    committed.append("workflow/lib/x.py")
    with pytest.raises(
        InputError, match="proof.seed: 'commit' needs code without changes, but workflow/lib/x.py differs"
    ):
        registration.registration({"seed": SEED}, [], files["seals"])
    registered = registration.registration({"seed": 16}, TRUTHS, files["seals"])
    assert (registered["changed"], registered["cases"], registered["simulators"]) == (committed, 9, ["xcist"])
    seal.write(registered, tmp_path / "registration.json")
    registration.log_run(tmp_path / "runs.jsonl", "registered", registered)
    assert assessed(tmp_path, settings={"seed": 16})["reasons"] == [
        "its seed was chosen",
        "the code had changes that were not committed",
        "a start had another commit or changed code",
    ]


def test_other_code_or_seals_at_the_score_do_not_count(run, monkeypatch):
    found = assessed(run)
    assert found["counts"] and found["starts"] == 2
    seal.write({case: "0" for case in CASES}, run / "seals.json")
    monkeypatch.setattr(registration, "commit", lambda: "f" * 40)
    monkeypatch.setattr(registration, "RULE", "another text")
    assert [reason.split(" changed")[0] for reason in assessed(run)["reasons"]] == [
        "the code",
        "the scoring rule",
        "the seals",
    ]


def test_part_of_the_registered_suite_does_not_count(run):
    assert assessed(run, CASES[:-2])["reasons"] == ["2 of 9 registered cases were not scored"]
    assert assessed(run, settings=SETTINGS | {"strengths": ("strong",)})["reasons"] == [
        "the settings changed after the registration"
    ]
    fewer = seal.read(run / "registration.json") | {"seals_sha256": "0" * 64}
    registration.log_run(run / "runs.jsonl", "registered", fewer)
    assert assessed(run)["reasons"] == ["another suite was registered with this commit and seed"]


def test_every_start_is_logged_and_must_have_the_registered_code(run, committed):
    """A resumed run logs its state; the job that registers a run logs the first start."""
    files = {"registration": run / "registration.json"}
    proof = SimpleNamespace(
        files=files.get, all=lambda name: [run / "diagnosis" / case / "diagnosis.json" for case in CASES]
    )
    benchmark = Benchmark(proof, "")
    (run / "diagnosis" / CASES[0] / "diagnosis.json").unlink()
    for rules in ({"proof_scan", "project"}, {"proof_seal", "proof_scan"}, {"project"}, {"proof_suite"}):
        benchmark.log_start(rules)
    last = json.loads((run / "runs.jsonl").read_text().splitlines()[-1])
    assert {key: last[key] for key in ("event", "commit", "seed", "done", "changed")} == {
        **{"event": "resumed", "commit": COMMIT, "seed": SEED},
        **{"done": 8, "changed": 0},
    }
    assert assessed(run)["counts"] and assessed(run)["starts"] == 3
    committed.append("workflow/lib/x.py")
    benchmark.log_start({"proof_diagnosis"})
    committed.clear()
    assert assessed(run)["reasons"] == ["a start had another commit or changed code"]
    (run / "runs.jsonl").unlink()
    assert assessed(run)["reasons"] == ["its start is not in the log of runs"]


def test_registered_run_is_added_once_and_fills_the_pages(record, run, command, tmp_path):
    path = record(entry("abc"))
    before = path.read_text()
    code, text = command(path, "add", run / "score.json", "--note", "first")
    assert code == 0 and path.read_text().startswith(before)
    added = read_proof_record(path)[1]
    assert (added.seed, added.commit, added.cases, added.rule) == (SEED, COMMIT, 9, 4)
    assert added.attempts == {"registered": 1, "resumed": 1, "failed": 1, "scored": 0}
    assert added.counts["first_medium_or_strong"] == (1.5, 2) and added.own["first_weak"] == (0, 1)
    assert added.coverage["scatter"] == (1, 2) and "first_weak" not in added.counts
    for page in PAGES:
        assert "\n".join(table_of(added)) in (tmp_path / page).read_text()
    code, text = command(path, "add", run / "score.json", "--note", "again")
    assert code == 1 and text.err == f"Error: {path}: already has commit {COMMIT}; one run of a commit counts\n"
    found = json.loads((run / "score.json").read_text())
    found["registration"] |= {"counts": False, "reasons": ["its seed was chosen"]}
    seal.write(found, run / "score.json")
    code, text = command(path, "add", run / "score.json", "--note", "n")
    assert code == 1 and "does not count, because its seed was chosen" in text.err


def test_drawn_confusion_matrix_is_that_of_the_last_run(record, run, tmp_path, monkeypatch):
    monkeypatch.setattr(proof_confusion, "OUT", tmp_path / "matrix.png")
    monkeypatch.setattr(proof_confusion, "RECORD", record(entry(COMMIT), entry("abc")))
    with pytest.raises(SystemExit, match=f"{run}/score.json: is not of commit abc"):
        proof_confusion.main(run / "score.json")
    record(entry("abc"), entry(COMMIT))
    proof_confusion.main(run / "score.json")
    assert proof_confusion.OUT.stat().st_size


def test_pages_are_replaced_as_a_whole(record, command, tmp_path, monkeypatch):
    """If the disk is full, the old page stays."""
    before = (tmp_path / PAGES[0]).read_text()

    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    code, text = command(record(entry("abc")), "pages")
    assert code == 1 and text.err == f"Error: {tmp_path / PAGES[0]}: cannot be written: {DISK_PROBLEMS[errno.ENOSPC]}\n"
    assert (tmp_path / PAGES[0]).read_text() == before and not list(tmp_path.glob(".partial*"))


def test_score_as_a_table_and_coverage_from_the_command_line(record, run, command):
    code, text = command(record(entry("abc")), "rows", run / "score.json")
    table = text.out.splitlines()
    assert code == 0 and {line.count("|") for line in table} == {5}
    width = "| width of 95 % intervals, relative to the hidden strength, median | 13 % |  |  |"
    assert width in table  # the mean of 0.008 of 0.05 and 0.01 of 0.1
    row = "| one medium or strong effect: ranked first | 1.5 of 2 (75 %; 20 to 97 %) | at least 93 % | **missed** |"
    assert row in table
    wrong = "held-out excess RMS removed, median and tenth percentile: an effect named that is not hidden"
    assert f"| {wrong} | 65 %, 53 % of 4 cases |  |  |" in table
    code, text = command(record(entry("abc")), "coverage", run / "score.json", run / "score.json")
    assert code == 0 and "seed 14" in text.out


def test_coverage_of_two_scores_in_one_table(run):
    lines = [line.split() for line in coverage_table(seal.read(run / "score.json"), score([], suite={"seed": 13}))]
    assert lines[0][-4:] == ["seed", "14", "seed", "13"]
    assert ["scatter", "1", "of", "2", "-"] in lines and ["all", "1", "of", "2", "-"] in lines


def test_diagnosis_states_the_coverage_of_each_interval_in_the_last_run(record):
    runs = read_proof_record(record(entry("a", {"motion": [9, 9]}), entry("b", {"scatter": [1, 4]})))
    values = {"scatter": {"amount": (0.1, 0.0, 0.2)}, "motion": {"x_mm": (1.0, 0.9, 1.1)}}
    text = with_coverage(diagnosis("a", "mismatch explained", values), runs)
    first, second = (effect["parameters"] for effect in text["effects"])
    whole = {"count": 6, "n": 10}
    assert first["amount"]["ci95_coverage"] == {"count": 1, "n": 4, "effects": ["scatter"], "all": whole}
    assert first["amount"]["ci95"] == [0.0, 0.2] and second["x_mm"]["ci95_coverage"]["count"] is None
    texts = [render_diagnosis("parameters", text, e=effect) for effect in text["effects"]]
    assert (
        "covered the true values of 1 of 4 parameters of scatter and of 6 of 10 parameters of all effects."
        in unescape(texts[0])
    )
    assert "of 6 of 10 parameters of all effects (none of this effect were tested)." in unescape(texts[1])
    plain = diagnosis("a", "mismatch explained", values)["effects"][0]
    assert "covered the true values" not in render_diagnosis("parameters", text, e=plain)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([entry("a"), entry("a")], "has commit a twice"),
        ([entry("a", pairs=[3, 2])], "is not a count and its total"),
        ([entry("a", couples=[1, 2])], "there is no count couples"),
        ([{"seed": 1}], "is not a record of the blind validation"),
    ],
)
def test_broken_record_is_one_line(record, entries, message):
    with pytest.raises(InputError, match=f"record.yaml: .*{message}"):
        read_proof_record(record(*entries))


@pytest.mark.parametrize("page", PAGES)
def test_pages_have_the_last_run(page):
    """After a run is added: python workflow/scripts/proof_record.py pages."""
    text, published = (ROOT / page).read_text(), read_proof_record(RECORD)[-1]
    assert filled(text, published) == text and "\n".join(table_of(published)) in text


def test_pages_state_the_number_of_effects():
    """All numbers that change with a new effect."""
    known, all_ = len(names()) - len(never_hidden()), len(names())
    stated = {
        "README.md": (f"It also fits {all_} physical effects", f"The tests cover {known} of the {all_} effects."),
        "docs/validation/blind-validation.md": (f"{known} of the library's {all_} ([list]",),
    }
    pages = {path: " ".join((ROOT / path).read_text().split()) for path in stated}
    missing = [f"{path}: write {text!r}" for path, texts in stated.items() for text in texts if text not in pages[path]]
    assert not missing, "\n".join(missing)


def test_docs_state_the_origin_of_the_equations():
    page = validation_tables.page()
    for source, made in zip(EQUATIONS.values(), MODELS.values(), strict=True):
        known, lacking = (", ".join(label(one) for one in made if (one in names()) == kind) for kind in (True, False))
        assert f"| {source} | {known} | {lacking} |" in page
    assert f"Never hidden: {', '.join(map(label, never_hidden()))}." in page


def test_generated_page_has_the_last_run_and_every_table():
    page = validation_tables.page()
    published = read_proof_record(RECORD)[-1]
    assert "\n".join(table_of(published)) in page and f"commit {published.commit}" in page
    for name, (count, n) in published.coverage.items():
        assert f"| {label(name)} | {count} of {n} |" in page
    results = yaml.safe_load(validation_tables.RESULTS.read_text())
    titles = [table["name"] for section in results for table in section["tables"]]
    assert len(set(titles)) == len(titles) and all(f"\n### {title}\n" in page for title in titles)
    with pytest.raises(ValueError, match="has 1 cells; the header has 2"):
        validation_tables.table(["a", "b"], [["c"]])
