"""Diagnosis of acquisitions of a tiny study with effects as a recording."""

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
from virtual_phantom.report.words import DOMAINS, describe_nuisance
from virtual_phantom.study.progress.status import duration_range

HIDDEN = {"scatter": {"amount": 0.04}, "electronic_noise": {"photons": 80.0}}
OF_SCANNER = ["bench", "second", "third"]
EFFECTS = ["scatter", "electronic_noise", "detector_offset", "xray_crosstalk"]
# The scanned object is the phantom of the study itself. The set-up is checked for `wrong` and `third`.
BENCH = {"effects": EFFECTS, "object_exact": True, "check_setup": False}
QUICK = {"samples": 1, "effects": ["scatter"], "view_step": 2, "check_setup": False, "object_exact": True}
VIEWS, ROWS, COLUMNS = 40, 12, 68
SCAN = {"trajectory": "circular", "columns": COLUMNS, "rows": ROWS, "column_pitch_mm": 9.5, "row_pitch_mm": 16.0}
STUDY = {
    "grid": {"shape": [12, 64, 64], "spacing_mm": [8.0, 4.7, 4.7]},
    "noise": {"model": "physical", "levels": {"bench": {"A": 1.0e-5, "repeats": 4}}},
    "scan": SCAN,
    "protocols": {"bench": {"algorithm": "fbp", "projections": VIEWS}},
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the recording `bench` and its diagnosis under `results`."""
    folder = tmp_path_factory.mktemp("bench")
    hidden = {**STUDY, "physics": HIDDEN, "keep_projections": True}
    whole = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
    whole["noise"]["model"] = "physical"
    whole = {**whole, "physics": HIDDEN, "protocols": whole["protocols"] | STUDY["protocols"]}
    label = Plan(read_study(whole)).geometry_of("bench")
    made = folder / "made"
    targets = [f"{made}/projections/{label}/bench/seed{seed:02d}.h5" for seed in range(4)]
    process = tiny(made, *targets, overlay=hidden, config_folder=folder / "hidden")
    assert process.returncode == 0, process.stderr[-4000:]
    import_study(made / "projections" / label / "bench", folder / "bench")
    shutil.copytree(made / "phantom", folder / "results" / "phantom")
    process = diagnosis(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    (folder / "said").write_text(process.stdout)
    return folder


def diagnosis(folder, *arguments, target="diagnosis", **settings):
    diagnosed = {"samples": 1, **BENCH}
    overlay = {
        **STUDY,
        "recordings": {"bench": str(folder / "bench")},
        "diagnosis": {"recordings": {"bench": diagnosed | settings}},
    }
    return tiny(folder / "results", target, *arguments, overlay=overlay, config_folder=folder / "overlay")


def shown(found, where):
    """Whether a text shows all lines of a verdict."""
    return all(line in where for line in found["verdict_lines"])


def test_hidden_effects_are_named_and_the_report_exists(bench):
    folder = bench / "results" / "diagnosis" / "bench"
    found = json.loads((folder / "diagnosis.json").read_text())
    assert found["verdict"] == "mismatch explained", found["sentence"]
    effects = {effect["name"]: effect["parameters"] for effect in found["effects"]}
    assert set(effects) == set(HIDDEN)
    for name, key in (("scatter", "amount"), ("electronic_noise", "photons")):
        low, high = effects[name][key]["ci95"]
        least, most = effects[name][key]["ci95_noise"]
        assert low < least < most < high  # with model errors
        assert low - (high - low) / 2 < HIDDEN[name][key] < high + (high - low) / 2
    assert effects["electronic_noise"]["photons"]["ci95_coverage"]["all"]["n"] > 0
    assert found["excess_removed"] > 0.9
    report = (folder / "report.html").read_text()
    assert report.startswith("<!doctype html>") and shown(found, html.unescape(report))
    assert "such intervals covered the true values of" in report
    assert found["modelled"]["effects tried"] == "scatter, electronic noise, detector offset, X-ray crosstalk"
    assert "plausible" in report and "middle slice of the scanned object" in report
    assert {place["domain"] for place in found["locations"]} <= set(DOMAINS)
    assert all(description in html.unescape(report) for description, _ in map(describe_nuisance, found["alignment"]))
    for place in found["locations"]:
        assert (folder / "maps" / place["map"]).stat().st_size > 0
    before, after = (np.load(folder / "maps" / f"residuals {name}.npy") for name in ("before", "after"))
    assert before.shape == after.shape == (VIEWS, COLUMNS)
    assert (before**2).mean() > 2 > (after**2).mean()  # standard deviations of noise


def test_verdicts_of_fail_on_exit_with_an_error_after_all_outputs(bench):
    overlay = yaml.safe_load((bench / "overlay" / "overlay.yaml").read_text())
    for verdict, code in (("mismatch explained", 1), ("another object", 0)):
        overlay["diagnosis"]["fail_on"] = [verdict]
        process = tiny(bench / "results", "diagnosis", overlay=overlay, config_folder=bench / "failing")
        assert process.returncode == code, process.stderr[-4000:]
        assert ("verdicts of diagnosis.fail_on: bench (mismatch explained)" in process.stderr + process.stdout) == bool(
            code
        )
        assert (bench / "results" / "diagnosis" / "bench" / "report.html").is_file()


def test_time_is_stated_before_the_fits_and_by_the_plan(bench):
    (time_line,) = re.findall(
        r"^diagnosis of bench: .* with 2 processes \(CPU time (.*); (.*)\)$", (bench / "said").read_text(), re.M
    )
    assert time_line[1] == "4 effects, 33 thousand rays"  # 40 views of 12 x 68 pixels, one ray each
    log = (bench / "results" / "logs" / "diagnosis" / "bench" / "diagnose.log").read_text()
    assert log.index("diagnosis of bench: ") < log.index("fitted the alignment")
    assert not [path for path in (bench / "results" / "logs").rglob(".*") if path.suffix == ".now"]
    process = diagnosis(bench, target="plan")
    assert process.returncode == 0, process.stderr[-4000:]
    (forecast,) = json.loads((bench / "results" / "plan.json").read_text())["diagnoses"]
    assert forecast["rays"] == VIEWS * ROWS * COLUMNS and forecast["effects"] == 4
    assert time_line[0] == duration_range(*forecast["cpu_seconds"])
    assert re.search(rf"^bench +4 +33 thousand rays +2 +{duration_range(*forecast['seconds'])}$", process.stdout, re.M)


def test_its_physics_is_an_overlay_that_the_study_accepts(bench):
    physics = yaml.safe_load((bench / "results" / "diagnosis" / "bench" / "physics.yaml").read_text())
    assert set(physics["physics"]) == set(HIDDEN) and physics["noise"] == {"model": "physical"}
    process = tiny(
        bench / "results", "-n", overlay={**STUDY, "physics": physics["physics"]}, config_folder=bench / "richer"
    )
    jobs = planned(process)
    assert jobs["project"] and all("_physics_" in job for job in jobs["project"])


def twin(bench, *arguments, of="bench"):
    """A study on the scanner of the diagnosis of `of`, and with the same protocols without its physics."""
    overlay = {
        **STUDY,
        "recordings": {of: str(bench / of)},
        "diagnosis": {"recordings": {of: {"samples": 1, **(BENCH if of == "bench" else {})}}},
        "physics": {"from": of},
        "protocols": {
            **{f"{kind}_{views}": None for kind in ("sirt", "fbp") for views in (150, 200, 250, 300, 450)},
            "bench": {"algorithm": "fbp", "projections": VIEWS, "group": 1},
            "fewer": {"algorithm": "fbp", "projections": 32, "group": 2},
        },
        "analyses": {
            **dict.fromkeys(("optimal", "noise_calibration", "pca", "extraction")),
            "stability": {"noise": "bench", "without_physics": True},
        },
        "measured": {"overlay": False},
    }
    return tiny(bench / "results", *arguments, overlay=overlay, config_folder=bench / "twin")


def test_study_runs_on_the_diagnosed_scanner(bench):
    """A missing diagnosis is made first, its effects are in the scans, and a table contains both."""
    physics = bench / "results" / "diagnosis" / "bench" / "physics.yaml"
    content_before = physics.read_bytes()
    physics.unlink()
    jobs = planned(twin(bench, "-n"))
    assert jobs["diagnose"] and len(jobs["project"]) == 4
    assert sum("_physics_of_bench" in job for job in jobs["project"]) == 2
    physics.write_bytes(content_before)
    process = twin(bench)
    assert process.returncode == 0, process.stderr[-4000:]
    results = bench / "results"
    log = (results / "logs" / "project" / f"views{VIEWS}_physics_of_bench_clean.log").read_text()
    found = yaml.safe_load(content_before)["physics"]
    assert f"effects: {found}" in log
    table = pd.read_csv(results / "tables" / "physics_change.csv").set_index("feature")
    stability = pd.read_csv(results / "tables" / "stability.csv").set_index("feature")["stability_percent"]
    np.testing.assert_allclose(table["with_percent"], stability.loc[table.index])
    features = pd.read_csv(results / "features.csv")
    assert set(features["protocol"]) == {"bench", "fewer", "bench_without_physics", "fewer_without_physics"}
    means = features.groupby("protocol")["original_firstorder_Mean"].mean()
    assert means["bench_without_physics"] - means["bench"] > 5  # scatter reduces HU
    assert (results / "figures" / "physics_change.png").stat().st_size > 0
    assert "With physics and without" in (results / "index.html").read_text()


def test_invalid_source_of_physics_is_one_line(bench):
    process = tiny(
        bench / "results", "-n", overlay={**STUDY, "physics": {"from": "bank"}}, config_folder=bench / "bank"
    )
    assert "physics.from names 'bank', which does not exist" in process.stderr
    edited = {"from": "bank", "scatter": None}
    process = tiny(bench / "results", "-n", overlay={**STUDY, "physics": edited}, config_folder=bench / "bank")
    assert "physics has from and scatter; keep one of them" in process.stderr


def diagnosis_of_more(bench, target, second=QUICK):
    """Diagnose the same scans again, with the physics found in them, and as recordings of a scanner."""
    overlay = {
        **STUDY,
        "recordings": {name: str(bench / "bench") for name in ("again", *OF_SCANNER)},
        "diagnosis": {
            "recordings": {
                "bench": {"samples": 1, **BENCH},
                "again": {"samples": 1, **BENCH, "baseline_from": "bench"},
                "second": second,
                "third": QUICK | {"check_setup": True},
            },
            "scanners": {"room": {"recordings": OF_SCANNER, "test_recordings": OF_SCANNER[2:]}},
        },
    }
    process = tiny(bench / "results", target, overlay=overlay, config_folder=bench / "next")
    assert process.returncode == 0, process.stderr[-4000:]
    return process.stdout


@pytest.fixture(scope="module")
def further(bench):
    """Folder and output of `diagnosis_of_more`."""
    printed = diagnosis_of_more(bench, "diagnosis")
    return bench / "results" / "diagnosis", printed


def test_found_physics_is_declared_for_the_next_recording(further):
    """With the physics found in the same scans declared, nothing is missing."""
    found = json.loads((further[0] / "again" / "diagnosis.json").read_text())
    assert (found["verdict"], found["effects"]) == ("match", [])
    assert set(found["declared"]) == set(HIDDEN) and abs(found["declared"]["scatter"]["amount"]["pull"]) < 3
    assert found["modelled"]["effects tried"] == "detector offset, X-ray crosstalk"


def test_recordings_of_a_scanner_are_diagnosed_together(further):
    folder = further[0] / "scanners" / "room"
    found = json.loads((folder / "scanner.json").read_text())
    assert [effect["name"] for effect in found["effects"]] == ["scatter"] and shown(found, further[1])
    assert [(name, one["test"]) for name, one in found["recordings"].items()] == [
        *zip(OF_SCANNER, (False, False, True), strict=True)
    ]
    assert not any(recording["agreement"]["disagrees"] for recording in found["recordings"].values())
    physics = yaml.safe_load((folder / "physics.yaml").read_text())["physics"]["scatter"]
    assert physics["amount"] == found["effects"][0]["parameters"]["amount"]["value"] == pytest.approx(0.04, rel=0.1)
    assert "(test recording)" in (folder / "report.html").read_text()


def test_only_outputs_affected_by_a_change_are_made_again(bench, further):
    assert planned(diagnosis(bench, "-n")) == {}
    folder = further[0] / "second"
    made = {path.name: path.stat().st_mtime_ns for path in (folder / "fits").glob("*.json")}
    assert {"alignment.json", "scatter.json"} <= set(made)  # other effects are fitted if they could win
    more = ["scatter", "veiling_glare"]
    diagnosis_of_more(bench, folder / "diagnosis.json", second=QUICK | {"effects": more})
    again = {path.name: path.stat().st_mtime_ns for path in (folder / "fits").glob("*.json")}
    assert "veiling_glare.json" in again.keys() - made.keys()
    assert made.items() <= again.items()


def test_bad_settings_are_one_line(bench):
    process = diagnosis(bench, "-n", effects=["glow"])
    assert process.returncode == 1 and "diagnosis.effects: there is no effect 'glow'" in process.stderr
    overlay = {**STUDY, "physics": {"scatter": {"amount": 7}}}
    process = tiny(bench / "results", "-n", overlay=overlay, config_folder=bench / "bad")
    assert process.returncode == 1
    assert "Error: config: protocols." in process.stderr and "amount: 7 is out of the plausible range" in process.stderr


def test_wrong_scan_description_ends_in_the_line_to_change(bench):
    """No effect is fitted, physics.yaml is empty and gives the reason, and physics_from stops in one line."""
    wrong = bench / "wrong"
    shutil.copytree(bench / "bench", wrong, ignore=shutil.ignore_patterns(".*"))
    for path in wrong.glob("*.h5"):
        with h5py.File(path, "a") as file:  # with angles in the file, reading it reports the mistake
            del file["exchange/theta"]
    text = (wrong / "recording.yaml").read_text()
    turned = -yaml.safe_load(text)["scan"]["direction"]
    (wrong / "recording.yaml").write_text(re.sub(r"direction: -?1", f"direction: {turned}", text))
    overlay = {**STUDY, "recordings": {"wrong": str(wrong), "bench": str(bench / "bench")}}
    overlay["diagnosis"] = {"recordings": {"wrong": {"samples": 1}}}
    process = tiny(bench / "results", "diagnosis", overlay=overlay, config_folder=bench / "wrong_overlay")
    assert process.returncode == 0, process.stderr[-4000:]
    folder = bench / "results" / "diagnosis" / "wrong"
    found = json.loads((folder / "diagnosis.json").read_text())
    assert (found["verdict"], found["effects"]) == ("description wrong", [])
    assert found["setup"]["mistakes"] == {"direction": f"scan.direction: {-turned}"}
    assert found["verdict_lines"][1] == f"Correction: scan.direction: {-turned}."
    assert shown(found, process.stdout)
    assert "diagnosis of wrong" not in process.stdout  # nothing will be fitted
    physics = (folder / "physics.yaml").read_text()
    assert yaml.safe_load(physics) == {} and shown(found, physics)
    page = (folder / "report.html").read_text()
    assert shown(found, html.unescape(page)) and "check_setup: false" in page
    overlay["diagnosis"]["recordings"]["bench"] = {"samples": 1, "physics_from": "wrong"}
    process = tiny(bench / "results", "diagnosis", overlay=overlay, config_folder=bench / "wrong_overlay")
    assert process.returncode == 1 and "No physics was fitted; correct this first" in process.stdout + process.stderr
    process = twin(bench, of="wrong")
    assert process.returncode == 1
    assert "wrong/physics.yaml: names no effect (" in process.stdout + process.stderr
