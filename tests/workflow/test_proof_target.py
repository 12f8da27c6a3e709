"""A small blind test: hidden by XCIST, diagnosed without the seals, scored, and protected from changes."""

import json
import shutil
from pathlib import Path

import pytest
from workflow_runs import planned, tiny

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.settings import FitSettings

# A quick diagnosis: the fault that the library lacks shows in the object, few views, no pair, and a seed whose case
# without a hidden effect is a disc.
QUICK = {
    "seed": 2040,
    "pairs": 0,
    "tried": ["scatter", "electronic_noise", "spectrum"],
    "unknown_kinds": ["wrong_insert"],
    "scan": {"columns": 60, "views": 24},
    "held_out_protocol": {"views": 24},
}
STEPS = ("seals.json", "score.json", "score.html", "figures/confusion.png", "figures/before_after.pdf")


def quick(results, *targets):
    return tiny(results, *targets, overlay={"proof": QUICK})


@pytest.fixture(scope="module")
def proof(tmp_path_factory):
    """Results of the tiny suite. The sealed folder is removed during the diagnosis."""
    folder = tmp_path_factory.mktemp("proof")
    results = folder / "results"
    made = results / "proof"
    cases = [f"case_{number:02d}" for number in range(1, 6)]
    process = quick(results, *(made / "recordings" / case for case in cases))
    assert process.returncode == 0, process.stderr[-4000:]
    shutil.move(made / "sealed", folder / "sealed")
    shutil.move(made / "seals.json", folder / "seals.json")
    diagnoses = [made / "diagnosis" / case / "diagnosis.json" for case in cases]
    # Recordings exist; their inputs are neither needed nor checked.
    process = quick(results, *diagnoses, "--allowed-rules", "proof_diagnosis")
    assert process.returncode == 0, process.stderr[-4000:]
    shutil.move(folder / "sealed", made / "sealed")
    shutil.move(folder / "seals.json", made / "seals.json")
    process = quick(results, "proof", "hide", "score")
    assert process.returncode == 0, process.stderr[-4000:]
    return results


def test_all_outputs_exist_and_are_scored(proof):
    for step in STEPS:
        assert (proof / "proof" / step).stat().st_size > 0, step
    score = json.loads((proof / "proof" / "score.json").read_text())
    assert score["counts"]["cases"] == 5
    assert planned(quick(proof, "proof", "-n")) == {}


def test_suite_for_other_programs_is_described(proof):
    """A request for the diagnosis can be made of it, and it names no hidden effect."""
    suite = json.loads((proof / "proof" / "suite.json").read_text())
    for given in suite["cases"].values():
        request = DiagnosisRequest.of(from_mapping(FitSettings, given["model"]), given["object"].get("phantom"), 1)
        assert (Path(request.folder) / "recording.yaml").exists()
        assert all(Path(path).exists() for path in given["object"].values())
        assert request.phantom or request.settings.disc or request.settings.object
        assert "scatter" in given["effects"] or given["model"].get("protocol")
        assert given.keys() == {"recording", "object", "model", "effects"}
    assert suite["effects"]["electronic_noise"] == {"photons": "photons"}


def test_suite_is_scored_as_the_diagnosis(proof):
    folder = proof / "proof"
    score = json.loads((folder / "score.json").read_text())
    program = json.loads((folder / "programs" / "diagnosis" / "score.json").read_text())
    assert program == {"program": "diagnosis"} | score["headline"]
    hashes = json.loads((folder / "programs" / "diagnosis" / "hashes.json").read_text())
    assert len(hashes) == 5


def test_run_is_registered_and_logged(proof):
    registered = json.loads((proof / "proof" / "registration.json").read_text())
    assert (registered["seed"], registered["cases"], registered["simulators"]) == (2040, 5, ["xcist"])
    events = [json.loads(line)["event"] for line in (proof / "proof" / "runs.jsonl").read_text().splitlines()]
    assert events == ["registered", "resumed", "resumed", "scored"]  # the fixture starts it three times
    score = json.loads((proof / "proof" / "score.json").read_text())
    assert not score["registration"]["counts"] and "its seed was chosen" in score["registration"]["reasons"]


def test_strong_effects_are_named(proof):
    """Three strong single effects, one of them on images, far above the noise."""
    for path in (proof / "proof" / "sealed").glob("[!.]*.json"):
        truth = json.loads(path.read_text())["truth"]
        found = json.loads((proof / "proof" / "diagnosis" / truth["case"] / "diagnosis.json").read_text())
        if truth["category"] == "single":
            assert found["effects"] and found["verdict"] != "match", found["sentence"]
            assert found["effects"][0]["name"] == truth["effects"][0]["name"], found["sentence"]
        if truth["category"] == "none":
            assert found["verdict"] == "match", found["sentence"]


def test_diagnosis_changed_after_its_verdict_is_rejected(proof, tmp_path):
    copy = tmp_path / "results"
    shutil.copytree(proof, copy)
    path = copy / "proof" / "diagnosis" / "case_01" / "diagnosis.json"
    path.write_text(path.read_text().replace("case_01", "case_O1", 1))
    (copy / "proof" / "score.json").unlink()
    process = quick(copy, "proof", "--allowed-rules", "proof", "proof_score")
    assert process.returncode != 0
    assert "case_01" in process.stderr and "diagnosis" in process.stderr
    *_, last = (copy / "proof" / "runs.jsonl").read_text().splitlines()
    assert json.loads(last)["event"] == "failed"
