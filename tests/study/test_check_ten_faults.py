"""`virtual-phantom check` with ten faulty inputs in one configuration: one run names each, and nothing else."""

import shutil
from pathlib import Path

import numpy as np
import phantom_files
import pytest
import recording_folders
import structure_files
import yaml
from phantom_files import ball, object_hu, write_nifti_array

from virtual_phantom.base.geometry import Grid
from virtual_phantom.cli import main

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A CT clipped to a window, masks, a structure set, and recordings of images and tables, each with a fault."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "config", "config")
    noise = np.random.default_rng(0).normal(0, 10, phantom_files.CT_GRID.shape)
    write_nifti_array(np.clip(object_hu() + noise, -160, 240).round().astype(np.float32), "ct.nii.gz")
    write_nifti_array((ball("bright") + 2 * ball("dark")).astype(np.uint8), "labels.nii.gz")
    write_nifti_array(np.where(ball("dark"), 0.93, 0.02).astype(np.float32), "probability.nii.gz")
    circles = [structure_files.contour(structure_files.circle(8, z)) for z in structure_files.Z[4:9]]
    structure_files.structure_set((1, "Liver", circles), path="rt.dcm")
    Path("params.yaml").write_text("imageType: {Original: {}}\nfeatureClass: {firstorder: [Mean, Medain]}\n")
    # HU + 1024, as some converters write it
    _, images = recording_folders.images_folder(Path("scanner"))
    write_nifti_array((object_hu() + 1024 + noise.clip(-20)).astype(np.float32), "scanner/two.nii.gz")
    # a row of a table shifted by one column
    _, table = recording_folders.features_folder(Path("clinic"))
    lines = Path("clinic/b.csv").read_text().splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([*cells[:6], *cells[5:-1]])
    Path("clinic/b.csv").write_text("\n".join(lines) + "\n")
    recording_folders.write_yaml(Path("clinic"), table)


def roi(name, tissue_class="organ", **more):
    return {"name": name, "tissue_class": tissue_class, **more}


CONFIG = {
    "base": "config/paper_groups.yaml",
    "phantom": {
        "source": "ct",
        "ct": {
            "image": "ct.nii.gz",
            "labels": "labels.nii.gz",
            "rois": [
                roi("bright", "tumour", label=1),
                roi("lost", label=9),
                roi("fractions", file="probability.nii.gz"),
                roi("liver", file="rt.dcm", label="Lievr"),
                roi("thin", label=2, margin_mm=30),
            ],
        },
    },
    "grid": {"shape": [14, 34, 42], "spacing_mm": [3.0, 2.0, 2.0]},
    "features": {"parameters": "params.yaml"},
    "protocols": {"sirt_180": {"algorithm": "sirt", "projections": 180, "gruop": 2}},
    "noise": {"levels": {"dose10": {"repeats": 0}}},
    "measured": {"overlay": False},
    "recordings": {"scanner": "scanner", "clinic": "clinic"},
}

EXPECTED = [
    "config: unknown key 'gruop' in protocols.sirt_180; did you mean 'group'?",
    "config: noise.levels.dose10.repeats: 0 is less than the minimum of 1; give at least 1",
    "phantom.ct.image: ct.nii.gz: 48 % of the voxels are exactly -160, the lowest value: it was clipped to a display",
    "ROI lost: labels.nii.gz: no voxel has the label 9; there are: 1, 2",
    "probability.nii.gz: holds fractions from 0.02 to 0.93, as probabilities or an interpolated mask do",
    "ROI liver: rt.dcm: ROI 'Lievr' is not there; did you mean 'Liver'?",
    "ROI thin is lost by margin_mm 30; make it smaller",
    "params.yaml: is no parameter file of pyradiomics: Feature Class firstorder contains unrecognized features: {'Med",
    "clinic/b.csv: row 4 cannot be right: Minimum is at most 10Percentile, but the values are 39.7328 and 4.30166",
    "scanner/two.nii.gz: values go from 4 to 1.16e+03, so these are not HU; perhaps magnitudes, as of MR, or HU + 1024",
]


def test_ten_faults_are_ten_lines(desk, capsys):
    Path("my.yaml").write_text(yaml.safe_dump(CONFIG))
    assert main.main(["check", "my.yaml"]) == 1
    head, *lines = capsys.readouterr().err.splitlines()
    assert head == "Error: 10 mistakes"
    found = [line.split(". ", 1)[1] for line in lines]
    assert len(found) == len(EXPECTED)
    for line, expected in zip(found, EXPECTED, strict=True):
        assert line.startswith(expected), line


def test_all_images_of_a_recording_are_read(desk, capsys):
    """Images of another size, in 1/mm, and of another format get a line each."""
    Path("scanner/three.nii.gz").write_text("no image")
    write_nifti_array(object_hu()[1:], "scanner/four.nii.gz", grid=Grid((13, 40, 48), (3, 2, 2), (5, -40, 301.5)))
    document = yaml.safe_load(Path("scanner/recording.yaml").read_text())
    document["repeats"] += ["three.nii.gz", "four.nii.gz"]
    Path("scanner/recording.yaml").write_text(yaml.safe_dump(document))
    Path("my.yaml").write_text(yaml.safe_dump({"recordings": {"scanner": "scanner"}}))
    assert main.main(["check", "my.yaml"]) == 1
    head, *lines = capsys.readouterr().err.splitlines()
    assert head == "Error: 3 mistakes"
    for line, words in zip(lines, ("two.nii.gz: values go", "three.nii.gz: has no", "four.nii.gz: is on"), strict=True):
        assert f"scanner/{words}" in line
