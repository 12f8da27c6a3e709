"""`snakemake diagnosis` of an object given by a label map, which is an input of its jobs."""

import json

import pytest
from drawn_objects import MATERIALS, SPECTRUM, bench, drawn
from workflow_runs import planned, tiny


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a recording of two materials, with the object as a label map."""
    folder = tmp_path_factory.mktemp("labels")
    (folder / "bench").mkdir()
    bench(folder / "bench", {"spectrum": SPECTRUM})
    drawn(folder / "labels.nii.gz", 0.5)
    return folder


def diagnosis(folder, *arguments):
    object_ = {"labels": str(folder / "labels.nii.gz"), "materials": MATERIALS}
    # tests/diagnosis/test_labelled_diagnosed.py checks the set-up of this scan.
    diagnosed = {"effects": ["spectrum", "scatter"], "object": object_, "object_exact": True, "check_setup": False}
    overlay = {
        "recordings": {"bench": str(folder / "bench")},
        "diagnosis": {"recordings": {"bench": diagnosed}},
    }
    return tiny(folder / "results", "diagnosis", *arguments, overlay=overlay, config_folder=folder / "overlay")


def test_label_map_is_diagnosed_and_again_after_a_change(folder):
    process = diagnosis(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    made = folder / "results" / "diagnosis" / "bench"
    found = json.loads((made / "diagnosis.json").read_text())
    assert [effect["name"] for effect in found["effects"]] == ["spectrum"], found["sentence"]
    assert found["modelled"]["object"] == "the label map labels.nii.gz, of pmma and aluminium"
    assert found["modelled"]["uncertainty of the object"] == "none: stated as exact"
    contrast = found["agreement"]["metrics"]["contrast"]
    off = [abs(contrast[when]["relative_difference"]) for when in ("after", "before")]
    assert off[0] < 0.01 < 0.1 < off[1]
    assert "middle slice of the scanned object" in (made / "report.html").read_text()
    assert "diagnose" not in planned(diagnosis(folder, "-n"))
    drawn(folder / "labels.nii.gz", 0.4)
    assert "diagnose" in planned(diagnosis(folder, "-n"))
