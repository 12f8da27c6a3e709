"""A phantom that is the mean of scans: stand-ins of the public ones, simulated by us, whose truth is known."""

import nibabel
import numpy as np
import pandas as pd
import public_files
import pytest
import SimpleITK as sitk
import yaml
from pages import copy_project
from radiomics.featureextractor import RadiomicsFeatureExtractor
from test_fetch import PLACE, TABLE, TANDEM
from workflow_runs import ROOT, snakemake

NAMES = ("801", "802", "803", "804")
OTHERS = ("811", "812")
STUDY = {
    "grid": {"shape": [24, 84, 84], "spacing_mm": [4.0, 3.75, 3.75], "oversampling": 1},
    "scan": {"columns": 108, "rows": 30, "column_pitch_mm": 6.4, "row_pitch_mm": 6.4},
    "results_dir": "results",
}


@pytest.fixture(scope="module")
def standing_in(tmp_path_factory):
    """A copy of the project, scans 801 to 804, 811 and 812 in a folder, and what was scanned."""
    folder = tmp_path_factory.mktemp("printed")
    project, mine = folder / "project", folder / "mine"
    copy_project(ROOT, project)
    names = NAMES + OTHERS
    phantom, images, masks = public_files.simulated(len(names))
    of = dict(zip(names, images, strict=True))
    scans = public_files.write_bucket(public_files.listed(*names), mine, lambda scan: of[scan.name], masks)
    public_files.write_table(scans, project / TABLE)
    return project, mine, phantom, of


def run(project, mine, target, **changes):
    group = {"collection": TANDEM, "groups": [8]}
    chosen = {"phantom": group | {"acquisitions": [1, 2, 3, 4]}, "compared": group | {"acquisitions": [11, 12]}}
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
    assert sorted(path.name for path in (project / PLACE).iterdir()) == sorted(NAMES + OTHERS)

    table = pd.read_csv(project / "results/public_scans/scans.csv", dtype={"scan": str})
    assert table["scan"].tolist() == list(NAMES) and table["largest_mm"].max() < 0.2
    repeats = np.stack([images[name].array for name in NAMES]).astype(float)
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
    own = pd.read_csv(project / "results/public_scans/own_blur.csv").fillna({"region": ""})
    own = own.set_index(["what", "region"])
    assert (project / "results/public_scans/sharp.nii.gz").exists()
    resolution = own.loc[("mtf_half_per_mm", "")]
    assert resolution["without_own_blur"] > 1.1 * resolution["of_the_mean"]
    # The list's slice of 1 mm; SD of a Gaussian as wide at half its height.
    assert own.loc[("blur_along_z_mm", ""), "of_the_mean"] == pytest.approx(0.4247, abs=1e-4)
    by_segment = dict(zip(public_files.SEGMENTS, rois.index, strict=True))
    masks = {roi.name: roi.mask for roi in phantom.rois}
    for segment, name in by_segment.items():
        assert own.loc[("mean_hu", segment), "of_the_mean"] == pytest.approx(mean[masks[name]].mean(), abs=0.1)
    image = nibabel.load(project / "results/phantom/image.nii.gz").get_fdata()
    assert image.min() == -1000 and (image[0] == -1000).all() and (image[:, 0] == -1000).all()


def by_hand(image, mask, spacing):
    """Features of pyradiomics, called on the image that was written and not read by us."""
    extractor = RadiomicsFeatureExtractor(binWidth=25)
    images = [sitk.GetImageFromArray(one) for one in (image.astype(np.float32), mask.astype(np.uint8))]
    for one in images:
        one.SetSpacing(spacing)
    return extractor.execute(*images)


def test_features_of_the_other_scans_are_two_recordings(standing_in):
    """In three dimensions, and in two as the published table has them: largest section, stored values, pixels of 1."""
    project, mine, phantom, images = standing_in
    code, said, _ = run(project, mine, "results/recordings/printed_phantom/features.csv")
    assert code == 0, said[-3000:]
    table = pd.read_csv(project / "results/recordings/printed_phantom/features.csv")
    assert len(table) == 2 * 6 and set(table["image"]) == {"scan811", "scan812"}
    assert set(table["group"]) == {8} and set(table["acquisition"]) == {11, 12}
    flat = pd.read_csv(project / "results/public_scans/compared_2d/features.csv")
    settings = yaml.safe_load((project / "results/public_scans/compared_2d/recording.yaml").read_text())["features"]
    assert settings["dimensions"] == 2 and settings["stored_offset_hu"] == 1024
    classes = {roi.name: roi.tissue_class for roi in phantom.rois}
    hu = images["812"].array
    for roi in phantom.rois[:2]:
        largest = max(range(len(hu)), key=lambda k, mask=roi.mask: (mask[k].sum(), -k))
        in_two = by_hand(np.rint(hu[largest]) + 1024, roi.mask[largest], (1.0, 1.0))
        in_three = by_hand(np.pad(hu, 1), np.pad(roi.mask, 1), (3.75, 3.75, 4.0))
        for rows, expected in ((table, in_three), (flat, in_two)):
            (row,) = rows[(rows["image"] == "scan812") & (rows["roi"] == roi.name)].to_dict("records")
            assert row["tissue_class"] == classes[roi.name]
            compared = [name for name in expected if name.startswith("original_") and name in row]
            assert len(compared) == 86
            for name in compared:
                assert row[name] == pytest.approx(float(expected[name]), rel=1e-6), name


def test_a_region_that_is_none_is_one_line(standing_in):
    project, mine, _, _ = standing_in
    rois = yaml.safe_load((ROOT / "config/printed_phantom.yaml").read_text())["phantom"]["ct"]["rois"]
    rois[2]["label"] = "cyst_1"
    code, _, errors = run(project, mine, "results/phantom/image.nii.gz", phantom={"ct": {"rois": rois}})
    assert code == 1 and len(errors) == 1
    assert "cyst_1 has the label cyst_1, which is none of public_scans.regions; did you mean 'cyst1'?" in errors[0]
