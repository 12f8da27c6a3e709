"""Diagnosis of images of a tiny study with a blurring kernel as a recording."""

import html
import json
import shutil
from pathlib import Path

import pytest
import yaml
from workflow_runs import planned, tiny

from virtual_phantom.report.words import DOMAINS, describe_nuisance

HIDDEN = {"reconstruction_kernel": {"sigma_mm": 4.0}}
STUDY = {
    "grid": {"shape": [12, 56, 56], "spacing_mm": [8.0, 5.4, 5.4]},
    "noise": {
        "model": "physical",
        "levels": {"bench": {"A": 1.0e-5, "repeats": 4}, "low": {"A": 3.0e-6, "repeats": 3}},
    },
    "scan": {"trajectory": "circular", "columns": 68, "rows": 16, "column_pitch_mm": 9.5, "row_pitch_mm": 12.0},
    "protocols": {"bench": {"algorithm": "fbp", "projections": 32}},
    "analyses": {"noise_calibration": {"protocols": ["bench"], "noise": ["low", "bench"]}},
}


@pytest.fixture(scope="module")
def scanner(tmp_path_factory):
    """A folder with the recording `scanner` and its diagnosis under `results`."""
    folder = tmp_path_factory.mktemp("scanner")
    images = [f"{folder}/made/images/bench/bench/seed{seed:02d}.nii.gz" for seed in range(4)]
    process = tiny(folder / "made", *images, overlay={**STUDY, "physics": HIDDEN}, config_folder=folder / "hidden")
    assert process.returncode == 0, process.stderr[-4000:]
    recording = folder / "recording"
    recording.mkdir()
    names = [Path(shutil.copy(image, recording)).name for image in images]
    content = {"kind": "images", "name": "scanner", "repeats": names, "origin": {"citation": "simulated"}}
    (recording / "recording.yaml").write_text(yaml.safe_dump(content))
    process = diagnosis(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder


def diagnosis(folder, *arguments, **settings):
    diagnosed = {"protocol": "bench", "samples": 1, "effects": ["reconstruction_kernel", "hu_calibration"]} | settings
    overlay = {
        **STUDY,
        "recordings": {"scanner": str(folder / "recording")},
        "diagnosis": {"recordings": {"scanner": {key: value for key, value in diagnosed.items() if value}}},
    }
    return tiny(folder / "results", "diagnosis", *arguments, overlay=overlay, config_folder=folder / "overlay")


def test_kernel_is_named_with_its_width(scanner):
    folder = scanner / "results" / "diagnosis" / "scanner"
    found = json.loads((folder / "diagnosis.json").read_text())
    assert [effect["name"] for effect in found["effects"]] == ["reconstruction_kernel"], found["sentence"]
    low, high = found["effects"][0]["parameters"]["sigma_mm"]["ci95"]
    assert low - (high - low) / 2 < HIDDEN["reconstruction_kernel"]["sigma_mm"] < high + (high - low) / 2
    rms = found["held_out"]["rms_hu"]
    assert rms["after"] - rms["floor"] < 0.1 * (rms["before"] - rms["floor"])
    resolution = found["agreement"]["metrics"]["resolution"]
    assert abs(resolution["after"]["relative_difference"]) < 0.1 < resolution["before"]["relative_difference"]
    assert 0 < found["agreement"]["metrics"]["noise_magnitude"]["floor"] < 0.2
    page = (folder / "report.html").read_text()
    assert all(html.escape(line) in page for line in found["verdict_lines"])
    assert {place["domain"] for place in found["locations"]} <= set(DOMAINS)
    assert all(description in html.unescape(page) for description, _ in map(describe_nuisance, found["alignment"]))
    assert "FBP" in found["modelled"]["scan"]


def test_its_physics_is_an_overlay_for_images_only(scanner):
    physics = yaml.safe_load((scanner / "results" / "diagnosis" / "scanner" / "physics.yaml").read_text())
    overlay = {**STUDY, "physics": physics["physics"]}
    process = tiny(scanner / "made", "-n", overlay=overlay, config_folder=scanner / "richer")
    assert process.returncode == 0, process.stderr[-2000:]
    jobs = planned(process)
    assert jobs["reconstruct_0"] == ["protocol=bench"] and "geometry=views32, scan=clean" not in jobs["project"]


def test_bad_settings_are_one_line(scanner):
    for settings, line in (
        (
            {"protocol": None},
            "diagnosis.recordings.scanner: holds images; name the scanned object (disc, object), or the",
        ),
        ({"protocol": "none"}, "diagnosis.recordings.scanner.protocol"),
        ({"effects": ["gain_pattern"]}, "gain_pattern has one unknown per detector pixel"),
        ({"disc": {"diameter_mm": 70, "material": "pmma"}}, "scanner.protocol: is for images of the study's phantom"),
        ({"slices": [0, 3]}, "scanner.slices: are for images of an object"),
    ):
        process = diagnosis(scanner, "-n", **settings)
        assert process.returncode == 1 and line in process.stderr, process.stderr[-2000:]
