"""The blind test in small: concealed by XCIST, diagnosed without the seals, scored, and tampering caught."""

import json
import shutil

import pytest
from workflow_runs import planned, tiny

# A quick diagnosis: the fault that the library lacks shows in the object, and few views.
QUICK = {"seed": 2031, "unknown_kinds": ["wrong_insert"], "scan": {"views": 24}, "held_out_protocol": {"views": 24}}
STEPS = ("seals.json", "score.json", "score.html", "figures/confusion.png", "figures/before_after.pdf")


def quick(results, *targets):
    return tiny(results, *targets, overlay={"proof": QUICK})


@pytest.fixture(scope="module")
def proof(tmp_path_factory):
    """Results of the tiny suite. The sealed folder is taken away while the diagnosis works."""
    folder = tmp_path_factory.mktemp("proof")
    results = folder / "results"
    made = results / "proof"
    cases = [f"case_{number:02d}" for number in range(1, 7)]
    process = quick(results, *(made / "recordings" / case for case in cases))
    assert process.returncode == 0, process.stderr[-4000:]
    shutil.move(made / "sealed", folder / "sealed")
    shutil.move(made / "seals.json", folder / "seals.json")
    diagnoses = [made / "diagnosis" / case / "diagnosis.json" for case in cases]
    # Recordings are there; what made them is neither asked for nor looked at.
    process = quick(results, *diagnoses, "--allowed-rules", "proof_diagnosis")
    assert process.returncode == 0, process.stderr[-4000:]
    shutil.move(folder / "sealed", made / "sealed")
    shutil.move(folder / "seals.json", made / "seals.json")
    process = quick(results, "proof")
    assert process.returncode == 0, process.stderr[-4000:]
    return results


def test_everything_is_there_and_scored(proof):
    for step in STEPS:
        assert (proof / "proof" / step).stat().st_size > 0, step
    score = json.loads((proof / "proof" / "score.json").read_text())
    assert score["counts"]["cases"] == 6
    assert planned(quick(proof, "proof", "-n")) == {}


def test_strong_effects_are_named(proof):
    """Of three strong single effects, one of them of images, all of which stand far out of the noise."""
    for path in (proof / "proof" / "sealed").glob("[!.]*.json"):
        truth = json.loads(path.read_text())["truth"]
        found = json.loads((proof / "proof" / "diagnosis" / truth["case"] / "diagnosis.json").read_text())
        if truth["category"] == "single":
            assert found["effects"] and found["verdict"] != "match", found["sentence"]
            assert found["effects"][0]["name"] == truth["effects"][0]["name"], found["sentence"]
        if truth["category"] == "none":
            assert found["verdict"] == "match", found["sentence"]


def test_a_diagnosis_changed_after_its_verdict_is_refused(proof, tmp_path):
    copy = tmp_path / "results"
    shutil.copytree(proof, copy)
    path = copy / "proof" / "diagnosis" / "case_01" / "diagnosis.json"
    path.write_text(path.read_text().replace("case_01", "case_O1", 1))
    (copy / "proof" / "score.json").unlink()
    process = quick(copy, "proof", "--allowed-rules", "proof", "proof_score")
    assert process.returncode != 0
    assert "case_01" in process.stderr and "diagnosis" in process.stderr
