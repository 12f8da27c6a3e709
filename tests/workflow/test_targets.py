"""Documented targets can be planned with their configurations, and importers run as documented."""

import shutil

import numpy as np
import pytest
import yaml
from phantom_files import ball, write_nifti_array
from test_workflow import IMPORTED, recorded
from workflow_runs import ROOT, planned, snakemake

from virtual_phantom.recordings.importers import command as importer

TABLES = {
    "tandem": ROOT / "../shared/real/ct_phantom4radiomics/features_2d.csv",
    "dose_series": ROOT / "../shared/real/edge_dose_series/features_3d.csv",
}


def test_targets_of_the_default_study_can_be_planned(tmp_path):
    results = tmp_path / "results"
    series = results / "dicom" / "whole_fbp" / "mgy3" / "seed02" / "series"
    targets = ("proof", "report_page", "viewer", "dicom", "plan", series)
    jobs = planned(snakemake(*targets, "-n", "--config", f"results_dir={results}"))
    assert {"proof_scan", "proof_score", "study_report", "viewer_page", "plan"} <= set(jobs)
    assert "protocol=whole_fbp, noise=mgy3, seed=02" in jobs["dicom_series"] and len(jobs["dicom_series"]) == 3


def test_targets_of_the_helsinki_recordings_can_be_planned(tmp_path):
    """With substitutes of imported recordings: planning only reads their description."""
    named = {name: recorded(tmp_path / name, kind) for name, kind in IMPORTED["htc2022.yaml"].items()}
    masks = {"ta": named["ta"] / "object.nii.gz", "tb": named["tb"] / "object.nii.gz"}
    for mask in masks.values():
        write_nifti_array(ball("bright").astype(np.uint8), mask)
    overlay = {
        "results_dir": f"{tmp_path}/r",
        "recordings": {name: str(folder) for name, folder in named.items()},
        "diagnosis": {"recordings": {name: {"object": {"mask": str(mask)}} for name, mask in masks.items()}},
    }
    (tmp_path / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    settings = ("--configfile", "config/htc2022.yaml", tmp_path / "overlay.yaml")
    jobs = planned(snakemake("diagnosis", "proof", "-n", *settings))
    assert len(jobs["diagnose"]) >= 3 and "proof_score" in jobs


@pytest.mark.real
@pytest.mark.skipif(
    not all(path.exists() for path in TABLES.values()), reason="the published tables are not beside this checkout"
)
def test_published_tables_are_imported_by_the_commands_of_the_page(tmp_path, monkeypatch, capsys):
    text = (ROOT / "docs" / "how-to" / "recordings.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for name, table in TABLES.items():
        command = f"virtual-phantom-import features {table.name} recordings/{name}\n"
        assert command in text
        shutil.copy(table, tmp_path)
        assert importer.main(command.split()[1:]) == 0
        assert f"{name}: features, " in capsys.readouterr().out
        assert (tmp_path / "recordings" / name / "recording.yaml").exists()
