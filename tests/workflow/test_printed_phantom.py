"""A phantom that is the mean of scans: stand-ins of the public ones, simulated by us, whose truth is known."""

import nibabel
import numpy as np
import pandas as pd
import public_files
import pytest
import yaml
from pages import copy_project
from test_fetch import PLACE, TABLE, TANDEM
from workflow_runs import ROOT, snakemake

NAMES = ("801", "802", "803", "804")
STUDY = {
    "grid": {"shape": [24, 84, 84], "spacing_mm": [4.0, 3.75, 3.75], "oversampling": 1},
    "scan": {"columns": 108, "rows": 30, "column_pitch_mm": 6.4, "row_pitch_mm": 6.4},
    "results_dir": "results",
}


@pytest.fixture(scope="module")
def standing_in(tmp_path_factory):
    """A copy of the project, scans 801 to 804 in a folder, and what was scanned."""
    folder = tmp_path_factory.mktemp("printed")
    project, mine = folder / "project", folder / "mine"
    copy_project(ROOT, project)
    phantom, images, masks = public_files.simulated(len(NAMES))
    of = dict(zip(NAMES, images, strict=True))
    scans = public_files.write_bucket(public_files.listed(*NAMES), mine, lambda scan: of[scan.name], masks)
    public_files.write_table(scans, project / TABLE)
    return project, mine, phantom, images


def run(project, mine, target, **changes):
    chosen = {"phantom": {"collection": TANDEM, "groups": [8], "acquisitions": [1, 2, 3, 4]}, "compared": None}
    settings = STUDY | {"public_scans": chosen, "downloads": {"scans": str(mine)}} | changes
    (project / "mine.yaml").write_text(yaml.safe_dump(settings))
    files = ("config/printed_phantom.yaml", "mine.yaml")
    process = snakemake(target, "--configfile", *files, project=project, cores=1)
    said = process.stdout + process.stderr
    assert "Traceback" not in said, said[-3000:]
    return process.returncode, said, [line for line in said.splitlines() if line.startswith("Error:")]


def test_the_phantom_is_the_mean_of_the_scans(standing_in):
    project, mine, phantom, images = standing_in
    code, said, _ = run(project, mine, "results/phantom/image.nii.gz")
    assert code == 0, said[-3000:]
    assert sorted(path.name for path in (project / PLACE).iterdir()) == sorted(NAMES)

    table = pd.read_csv(project / "results/public_scans/scans.csv", dtype={"scan": str})
    assert table["scan"].tolist() == list(NAMES) and table["largest_mm"].max() < 0.2
    repeats = np.stack([image.array for image in images]).astype(float)
    inside = np.any([roi.mask for roi in phantom.rois], axis=0)
    noise = np.sqrt(repeats[:, inside].var(axis=0, ddof=1).mean())
    np.testing.assert_allclose(table["noise_hu"], noise, rtol=0.01)
    np.testing.assert_allclose(table["remaining_noise_hu"], noise / 2, rtol=0.01)

    rois = pd.read_csv(project / "results/phantom/rois.csv").set_index("roi")
    mean = repeats.mean(axis=0)
    assert list(rois.index) == ["normal_1", "normal_2", "cyst_1", "cyst_2", "hemangioma", "metastasis"]
    for roi in phantom.rois:
        assert rois.loc[roi.name, "tissue_class"] == roi.tissue_class
        # Another grid: half a voxel of interpolation, at most.
        assert rois.loc[roi.name, "n_voxels"] == pytest.approx(roi.mask.sum(), rel=0.35)
        assert rois.loc[roi.name, "mean_hu"] == pytest.approx(mean[roi.mask].mean(), abs=6)
    image = nibabel.load(project / "results/phantom/image.nii.gz").get_fdata()
    assert image.min() == -1000 and (image[0] == -1000).all() and (image[:, 0] == -1000).all()


def test_a_region_that_is_none_is_one_line(standing_in):
    project, mine, _, _ = standing_in
    rois = yaml.safe_load((ROOT / "config/printed_phantom.yaml").read_text())["phantom"]["ct"]["rois"]
    rois[0]["label"] = "normal"
    code, _, errors = run(project, mine, "results/phantom/image.nii.gz", phantom={"ct": {"rois": rois}})
    assert code == 1 and len(errors) == 1
    assert "normal_1 has the label normal, which is none of public_scans.regions; did you mean 'normal1'?" in errors[0]
