"""`snakemake recordings`: the list of readable recordings, and one line for others."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
import yaml
from recording_folders import features_folder, projections_folder, write_projections
from workflow_runs import TINY, snakemake


@pytest.fixture
def target(tmp_path):
    """Run the target with two recordings in the configuration, b and t."""
    bench, table = projections_folder(tmp_path / "bench")[0], features_folder(tmp_path / "table")[0]
    overlay = tmp_path / "overlay.yaml"
    content = {"results_dir": f"{tmp_path}/r", "recordings": {"b": str(bench), "t": str(table)}}
    overlay.write_text(yaml.safe_dump(content))
    return lambda *arguments: snakemake(*arguments, "recordings", "--configfile", TINY, overlay)


def test_target_lists_recordings_and_stops_at_a_bad_one(target, tmp_path):
    process = target()
    assert process.returncode == 0, process.stderr[-3000:]
    assert "b: projections, 2 repeats, 1 held out" in process.stdout and "t: features, 6 repeats" in process.stdout
    rows = pd.read_csv(tmp_path / "r" / "recordings" / "recordings.csv")
    assert rows["recording"].tolist() == ["b", "t"] and rows["kind"].tolist() == ["projections", "features"]
    found = json.loads((tmp_path / "r" / "recordings" / "b" / "summary.json").read_text())
    assert found["content"]["values"] == "counts"

    write_projections(tmp_path / "bench" / "b.h5", data=np.ones((23, 4, 40)))
    process = target()
    assert process.returncode == 1
    assert f"Error: {tmp_path}/bench/b.h5: has 23 views, but recording.yaml says scan.views 24" in process.stderr

    (tmp_path / "bench" / "recording.yaml").write_text("kind: projections")
    process = target("-n")
    lines = (process.stderr + process.stdout).splitlines()
    (place,) = (number for number, line in enumerate(lines) if line.startswith("Error:"))
    assert process.returncode == 1 and lines[place] == "Error: 3 mistakes" and "Traceback" not in process.stderr
    assert all(f"{tmp_path}/bench/recording.yaml: " in line for line in lines[place + 1 : place + 4])


def test_alignment_with_another_phantom_is_one_line(study, tmp_path):
    folder, overlay = tmp_path / "moved", tmp_path / "overlay.yaml"
    folder.mkdir()
    content = {"name": "moved", "kind": "images", "phantom": "bench", "repeats": ["a.nii.gz"]}
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    overlay.write_text(yaml.safe_dump({"results_dir": f"{tmp_path}/r", "recordings": {"m": str(folder)}}))
    shutil.copytree(study / "phantom", tmp_path / "r" / "phantom")
    shutil.copy(study / "phantom" / "image.nii.gz", folder / "a.nii.gz")
    process = snakemake("alignment", "--configfile", TINY, overlay)
    assert process.returncode == 1
    assert f"Error: {folder}/recording.yaml: phantom is 'bench', but the study's phantom is synthetic" in process.stderr
