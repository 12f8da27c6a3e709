"""Verdicts of any program: the job that scores them, and the key of the configuration."""

import json
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from proof_suite import DIAGNOSES, write_suite

from virtual_phantom.base.errors import InputError
from virtual_phantom.config.config import read_study
from virtual_phantom.config.outputs import Files
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.proof.scoring.verdicts import verdict_document
from virtual_phantom.study.benchmark import Benchmark
from virtual_phantom.study.proof import Proof

ROOT = Path(__file__).resolve().parents[2]


class Given(dict):
    """Snakemake's lists of named files."""

    __getattr__ = dict.__getitem__


def scored(folder, verdicts):
    """Run the script on verdicts of the suite of nine cases."""
    files = write_suite(folder)
    inputs = Given(sealed=files["sealed"], seals=files["seals"], verdicts=verdicts)
    output = Given(hashes=folder / "hashes.json", score=folder / "program.json", table=folder / "program.md")
    snakemake = SimpleNamespace(
        input=inputs, output=output, wildcards=SimpleNamespace(program="mine"), log=[folder / "log"], threads=1
    )
    runpy.run_path(str(ROOT / "workflow/scripts/score_verdicts.py"), {"snakemake": snakemake})
    return output


def written(folder, documents):
    folder.mkdir(exist_ok=True)
    for document in documents:
        (folder / f"{document['case']}.json").write_text(json.dumps(document))
    return sorted(folder.glob("*.json"))


def test_verdicts_of_a_program_are_scored(tmp_path):
    """A program that names scatter in every case."""
    cases = [diagnosis["recording"] for diagnosis in DIAGNOSES]
    said = [{"case": case, "effects": [["scatter"]], "unexplained": False} for case in cases]
    output = scored(tmp_path, written(tmp_path / "mine", said))
    found = json.loads(output["score"].read_text())
    counts = {name: (one["count"], one["n"]) for name, one in found["all"].items() if one["n"]}
    assert counts == {
        "first_medium_or_strong": (1, 2),
        "exact": (1, 3),
        "left_open": (0, 1),
        "pairs": (0, 1),
        "false_alarms": (2, 2),
        "unknown": (0, 2),
    }
    assert found["program"] == "mine" and len(json.loads(output["hashes"].read_text())) == 9
    row = (
        "| nothing hidden: false alarms | ≤ 5 %" + 2 * " | 2 of 2 (100 %; 34 to 100 %)" + " |  |"
    )  # also by significance
    assert row in output["table"].read_text().splitlines()


def test_each_bad_file_is_printed(tmp_path, capsys):
    said = [verdict_document(diagnosis) for diagnosis in DIAGNOSES[2:]]
    said[0]["effects"] = [["scater"]]
    with pytest.raises(SystemExit):
        scored(tmp_path, written(tmp_path / "mine", said))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "Error: 3 mistakes" and len(lines) == 4
    assert "case_01.json: is missing" in lines[1] and "did you mean 'scatter'?" in lines[3]
    assert not (tmp_path / "hashes.json").exists() and not (tmp_path / "program.json").exists()


def test_folder_of_verdicts_gives_name_and_files_of_the_program(tmp_path):
    study = read_study(read_configs([ROOT / "config/quick_proof.yaml"])[1])
    files = written(tmp_path / "mine", [verdict_document(DIAGNOSES[0])])

    def read(folder):
        return Benchmark.read(Proof.read(Plan(replace(study, verdicts=folder)), Files("r")))

    found = read(f"{tmp_path}/mine/")
    assert found.program == "mine" and found.verdict_files() == list(map(str, files))
    assert read("").program == "diagnosis" and read("").verdict_files()[0] == "r/proof/verdicts/case_01.json"
    with pytest.raises(InputError, match="verdicts: there is no folder .*/other; name a folder"):
        read(f"{tmp_path}/other")
