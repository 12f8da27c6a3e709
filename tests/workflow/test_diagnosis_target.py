"""A tiny study with effects switched on, its acquisitions handed back as a recording, and what the diagnosis says."""

import html
import json
import re
import shutil

import h5py
import numpy as np
import pandas as pd
import pytest
import yaml
from workflow_runs import ROOT, planned, tiny

from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.recordings.importers.study import import_study
from virtual_phantom.report.words import DOMAINS, NUISANCES
from virtual_phantom.study.progress.status import duration_range

CONCEALED = {"scatter": {"amount": 0.04}, "electronic_noise": {"photons": 80.0}}
OF_SCANNER = ["bench", "second", "third"]
EFFECTS = ["scatter", "electronic_noise", "detector_offset", "xray_crosstalk"]
SCAN = {"trajectory": "circular", "columns": 68, "rows": 16, "column_pitch_mm": 9.5, "row_pitch_mm": 12.0}
STUDY = {
    "noise": {"model": "physical", "levels": {"bench": {"A": 1.0e-5, "repeats": 4}}},
    "scan": SCAN,
    "protocols": {"bench": {"algorithm": "fbp", "projections": 90}},
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the recording `bench`, and what the diagnosis made of it under `results`."""
    folder = tmp_path_factory.mktemp("bench")
    concealed = {**STUDY, "physics": CONCEALED, "keep_projections": True}
    whole = yaml.safe_load((ROOT / "config" / "config.yaml").read_text())
    whole["noise"]["model"] = "physical"
    whole = {**whole, "physics": CONCEALED, "protocols": whole["protocols"] | STUDY["protocols"]}
    label = Plan(read_study(whole)).geometry_of("bench")
    made = folder / "made"
    targets = [f"{made}/projections/{label}/bench/seed{seed:02d}.h5" for seed in range(4)]
    process = tiny(made, *targets, overlay=concealed, beside=folder / "concealed")
    assert process.returncode == 0, process.stderr[-4000:]
    import_study(made / "projections" / label / "bench", folder / "bench")
    process = diagnosis(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    (folder / "said").write_text(process.stdout)
    return folder


def diagnosis(folder, *arguments, target="diagnosis", **settings):
    diagnosed = {"samples": 1, "effects": EFFECTS}
    overlay = {
        **STUDY,
        "recordings": {"bench": str(folder / "bench")},
        "diagnosis": {"recordings": {"bench": diagnosed | settings}},
    }
    return tiny(folder / "results", target, *arguments, overlay=overlay, beside=folder / "overlay")


def shown(found, where):
    """Whether a text shows all lines of a verdict."""
    return all(line in where for line in found["verdict_lines"])


def test_what_was_concealed_is_named_and_the_report_is_there(bench):
    folder = bench / "results" / "diagnosis" / "bench"
    found = json.loads((folder / "diagnosis.json").read_text())
    assert found["verdict"] == "mismatch explained", found["sentence"]
    effects = {effect["name"]: effect["parameters"] for effect in found["effects"]}
    assert set(effects) == set(CONCEALED)
    for name, key in (("scatter", "amount"), ("electronic_noise", "photons")):
        low, high = effects[name][key]["ci95"]
        least, most = effects[name][key]["ci95_noise"]
        assert low < least < most < high  # inexact models count too
        assert low - (high - low) / 2 < CONCEALED[name][key] < high + (high - low) / 2
    assert effects["electronic_noise"]["photons"]["ci95_held"]["all"]["n"] > 0
    assert found["excess_removed"] > 0.9
    report = (folder / "report.html").read_text()
    assert report.startswith("<!doctype html>") and shown(found, html.unescape(report))
    assert "noise-only intervals covered the true values of" in report
    assert found["modelled"]["effects tried"] == "scatter, electronic noise, detector offset, X-ray crosstalk"
    assert "plausible" in report and "middle slice of the scanned object" in report
    assert {place["domain"] for place in found["locations"]} <= set(DOMAINS) and set(found["alignment"]) <= set(
        NUISANCES
    )
    for place in found["locations"]:
        assert (folder / "maps" / place["map"]).stat().st_size > 0
    before, after = (np.load(folder / "maps" / f"residuals {name}.npy") for name in ("before", "after"))
    assert before.shape == after.shape == (90, SCAN["columns"])
    assert (before**2).mean() > 2 > (after**2).mean()  # standard deviations of noise


def test_verdicts_of_fail_on_end_with_an_error_once_all_is_written(bench):
    overlay = yaml.safe_load((bench / "overlay" / "overlay.yaml").read_text())
    for verdict, code in (("mismatch explained", 1), ("another object", 0)):
        overlay["diagnosis"]["fail_on"] = [verdict]
        process = tiny(bench / "results", "diagnosis", overlay=overlay, beside=bench / "failing")
        assert process.returncode == code, process.stderr[-4000:]
        assert ("verdicts of diagnosis.fail_on: bench (mismatch explained)" in process.stderr + process.stdout) == bool(
            code
        )
        assert (bench / "results" / "diagnosis" / "bench" / "report.html").is_file()


def test_its_time_is_told_before_it_fits_and_by_the_plan(bench):
    (said,) = re.findall(
        r"^diagnosis of bench: .* with 2 processes \(CPU time (.*); (.*)\)$", (bench / "said").read_text(), re.M
    )
    assert said[1] == "4 effects, 98 thousand rays"  # 90 views of 16 x 68 pixels, a ray each
    log = (bench / "results" / "logs" / "diagnosis" / "bench" / "diagnose.log").read_text()
    assert log.index("diagnosis of bench: ") < log.index("fitted the alignment")
    assert not [path for path in (bench / "results" / "logs").rglob(".*") if path.suffix == ".now"]
    process = diagnosis(bench, target="plan")
    assert process.returncode == 0, process.stderr[-4000:]
    (told,) = json.loads((bench / "results" / "plan.json").read_text())["diagnoses"]
    assert told["rays"] == 90 * 16 * 68 and told["effects"] == 4 and said[0] == duration_range(*told["cpu_seconds"])
    assert re.search(rf"^bench +4 +98 thousand rays +2 +{duration_range(*told['seconds'])}$", process.stdout, re.M)


def test_its_physics_is_an_overlay_that_the_study_takes(bench):
    physics = yaml.safe_load((bench / "results" / "diagnosis" / "bench" / "physics.yaml").read_text())
    assert set(physics["physics"]) == set(CONCEALED) and physics["noise"] == {"model": "physical"}
    process = tiny(bench / "results", "-n", overlay={**STUDY, "physics": physics["physics"]}, beside=bench / "richer")
    jobs = planned(process)
    assert jobs["project"] and all("_physics_" in job for job in jobs["project"])


def twin(bench, *arguments, of="bench"):
    """A study on the scanner that the diagnosis of `of` finds, with the same protocols without that physics."""
    overlay = {
        **STUDY,
        "recordings": {of: str(bench / of)},
        "diagnosis": {"recordings": {of: {"samples": 1, **({"effects": EFFECTS} if of == "bench" else {})}}},
        "physics": {"from": of},
        "protocols": {
            **{f"{kind}_{views}": None for kind in ("sirt", "fbp") for views in (150, 200, 250, 300, 450)},
            "bench": {"algorithm": "fbp", "projections": 90, "group": 1},
            "fewer": {"algorithm": "fbp", "projections": 70, "group": 2},
        },
        "analyses": {
            **dict.fromkeys(("optimal", "noise_calibration", "pca")),
            "stability": {"noise": "bench", "without_physics": True},
        },
        "measured": {"overlay": False},
    }
    return tiny(bench / "results", *arguments, overlay=overlay, beside=bench / "twin")


def test_the_study_runs_on_the_scanner_that_was_found(bench):
    """The diagnosis is made first where it is missing, its effects are in the scans, and a table holds both."""
    physics = bench / "results" / "diagnosis" / "bench" / "physics.yaml"
    kept = physics.read_bytes()
    physics.unlink()
    jobs = planned(twin(bench, "-n"))
    assert jobs["diagnose"] and len(jobs["project"]) == 4
    assert sum("_physics_of_bench" in job for job in jobs["project"]) == 2
    physics.write_bytes(kept)
    process = twin(bench)
    assert process.returncode == 0, process.stderr[-4000:]
    results = bench / "results"
    log = (results / "logs" / "project" / "views90_physics_of_bench.log").read_text()
    found = yaml.safe_load(kept)["physics"]
    assert f"effects: {found}" in log
    table = pd.read_csv(results / "tables" / "physics_change.csv").set_index("feature")
    stability = pd.read_csv(results / "tables" / "stability.csv").set_index("feature")["stability_percent"]
    np.testing.assert_allclose(table["with_percent"], stability.loc[table.index])
    features = pd.read_csv(results / "features.csv")
    assert set(features["protocol"]) == {"bench", "fewer", "bench_without_physics", "fewer_without_physics"}
    means = features.groupby("protocol")["original_firstorder_Mean"].mean()
    assert means["bench_without_physics"] - means["bench"] > 5  # scatter darkens
    assert (results / "figures" / "physics_change.png").stat().st_size > 0
    assert "With physics and without" in (results / "index.html").read_text()


def test_where_physics_cannot_come_from_is_said_in_one_line(bench):
    process = tiny(bench / "results", "-n", overlay={**STUDY, "physics": {"from": "bank"}}, beside=bench / "bank")
    assert "physics.from names 'bank', which does not exist" in process.stderr
    beside = {"from": "bank", "scatter": None}
    process = tiny(bench / "results", "-n", overlay={**STUDY, "physics": beside}, beside=bench / "bank")
    assert "physics has from and scatter; keep one of them" in process.stderr


@pytest.fixture(scope="module")
def further(bench):
    """The same scans again and again: beside what was found in them, and as recordings of a scanner."""
    quick = {"samples": 1, "effects": ["scatter"], "view_step": 5}
    overlay = {
        **STUDY,
        "recordings": {name: str(bench / "bench") for name in ("again", *OF_SCANNER)},
        "diagnosis": {
            "recordings": {
                "bench": {"samples": 1, "effects": EFFECTS},
                "again": {"samples": 1, "effects": EFFECTS, "baseline_from": "bench"},
                **dict.fromkeys(OF_SCANNER[1:], quick),
            },
            "scanners": {"room": {"recordings": OF_SCANNER, "judged_on": OF_SCANNER[2:]}},
        },
    }
    process = tiny(bench / "results", "diagnosis", overlay=overlay, beside=bench / "next")
    assert process.returncode == 0, process.stderr[-4000:]
    return bench / "results" / "diagnosis", process.stdout


def test_what_was_found_is_known_to_the_next_recording(further):
    """With what was found in the same scans declared, nothing is missing beside it."""
    found = json.loads((further[0] / "again" / "diagnosis.json").read_text())
    assert (found["verdict"], found["effects"]) == ("match", [])
    assert set(found["declared"]) == set(CONCEALED) and abs(found["declared"]["scatter"]["amount"]["pull"]) < 3
    assert found["modelled"]["effects tried"] == "detector offset, X-ray crosstalk"


def test_recordings_of_a_scanner_are_diagnosed_together(further):
    folder = further[0] / "scanners" / "room"
    found = json.loads((folder / "scanner.json").read_text())
    assert [one["name"] for one in found["effects"]] == ["scatter"] and shown(found, further[1])
    assert [(name, one["judged"]) for name, one in found["recordings"].items()] == [
        *zip(OF_SCANNER, (False, False, True), strict=True)
    ]
    assert not any(one["agreement"]["disagrees"] for one in found["recordings"].values())
    physics = yaml.safe_load((folder / "physics.yaml").read_text())["physics"]["scatter"]
    assert physics["amount"] == found["effects"][0]["parameters"]["amount"]["value"] == pytest.approx(0.04, rel=0.1)
    assert "(judges only)" in (folder / "report.html").read_text()


def test_only_what_a_change_touches_is_done_again(bench):
    assert planned(diagnosis(bench, "-n")) == {}
    folder = bench / "results" / "diagnosis" / "bench"
    made = {path.name: path.stat().st_mtime_ns for path in (folder / "fits").glob("*.json")}
    assert {"alignment.json", "scatter.json"} <= set(made)  # others are fitted if they could win
    process = diagnosis(bench, effects=[*EFFECTS, "veiling_glare"])
    assert process.returncode == 0, process.stderr[-4000:]
    again = {path.name: path.stat().st_mtime_ns for path in (folder / "fits").glob("*.json")}
    assert "veiling_glare.json" in again.keys() - made.keys()
    assert made.items() <= again.items()


def test_bad_settings_are_one_line(bench):
    process = diagnosis(bench, "-n", effects=["glow"])
    assert process.returncode == 1 and "diagnosis.effects: there is no effect 'glow'" in process.stderr
    overlay = {**STUDY, "physics": {"scatter": {"amount": 7}}}
    process = tiny(bench / "results", "-n", overlay=overlay, beside=bench / "bad")
    assert process.returncode == 1
    assert (
        "Error: config: protocols." in process.stderr and "amount: 7 1 is out of the plausible range" in process.stderr
    )


def test_a_scan_described_wrong_ends_in_the_line_to_change(bench):
    """No effect is fitted, its physics.yaml holds none and says why, and physics_from that stops in one line."""
    wrong = bench / "wrong"
    shutil.copytree(bench / "bench", wrong, ignore=shutil.ignore_patterns(".*"))
    for path in wrong.glob("*.h5"):
        with h5py.File(path, "a") as file:  # with angles in the file, reading it says the mistake
            del file["exchange/theta"]
    text = (wrong / "recording.yaml").read_text()
    turned = -yaml.safe_load(text)["scan"]["direction"]
    (wrong / "recording.yaml").write_text(re.sub(r"direction: -?1", f"direction: {turned}", text))
    overlay = {**STUDY, "recordings": {"wrong": str(wrong), "bench": str(bench / "bench")}}
    overlay["diagnosis"] = {"recordings": {"wrong": {"samples": 1}}}
    process = tiny(bench / "results", "diagnosis", overlay=overlay, beside=bench / "wrong_overlay")
    assert process.returncode == 0, process.stderr[-4000:]
    folder = bench / "results" / "diagnosis" / "wrong"
    found = json.loads((folder / "diagnosis.json").read_text())
    assert (found["verdict"], found["effects"]) == ("description wrong", [])
    assert found["setup"]["mistakes"] == {"direction": f"scan.direction: {-turned}"}
    assert found["verdict_lines"][1] == f"Correction: scan.direction: {-turned}."
    assert shown(found, process.stdout)
    assert "diagnosis of wrong" not in process.stdout  # nothing is going to be fitted
    physics = (folder / "physics.yaml").read_text()
    assert yaml.safe_load(physics) == {} and shown(found, physics)
    page = (folder / "report.html").read_text()
    assert shown(found, html.unescape(page)) and "check_setup: false" in page
    overlay["diagnosis"]["recordings"]["bench"] = {"samples": 1, "physics_from": "wrong"}
    process = tiny(bench / "results", "diagnosis", overlay=overlay, beside=bench / "wrong_overlay")
    assert process.returncode == 1 and "Physics cannot be taken from it" in process.stdout + process.stderr
    process = twin(bench, of="wrong")
    assert process.returncode == 1
    assert "wrong/physics.yaml: names no effect (" in process.stdout + process.stderr
