"""Images at a scanner's voxels, of a phantom re-positioned before some repeats, through the workflow."""

import shutil

import numpy as np
import pandas as pd
import pytest
from workflow_runs import tiny

from virtual_phantom.io.volumes import read_nifti

VOXELS = {"spacing_mm": [3.0, 2.0, 2.0], "thickness_mm": 5.0}
OVERLAY = {
    "noise": {
        "model": "physical",
        "levels": {"dose10": {"A": 1.0e-6, "repeats": 3}, **dict.fromkeys(("dose10_plus12", "double", "quadruple"))},
    },
    "protocols": {
        **{f"{name}_{views}": None for name in ("sirt", "fbp") for views in (300, 150)},
        "whole": {"algorithm": "fbp", "projections": 150, "group": 1},
        "boxed": {
            "algorithm": "fbp",
            "projections": 150,
            "group": 2,
            "kernel": {"mtf50_per_cm": 1.2, "mtf10_per_cm": 2.0},
            "voxels": VOXELS,
        },
    },
    "repeats": {"repositioned": 1, "shift_mm": 6.0, "turn_deg": 4.0},
    "features": {"section": "largest", "stored_offset_hu": 1024},
    "analyses": {"stability": {"noise": "dose10"}, "optimal": None, "noise_calibration": None, "pca": None}
    | {"extraction": None},
}


def middle(mask):
    """A region's center of mass, (z, y, x), mm from the isocenter."""
    return [axis[index].mean() for axis, index in zip(mask.grid.axes_mm(), np.nonzero(mask.array), strict=True)]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scanner_images") / "results"
    process = tiny(folder, folder / "features.csv", folder / "phantom" / "positions.csv", overlay=OVERLAY)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder


def test_last_repeat_has_the_pose_of_the_table(made):
    """Each region's center of mass is that of the others, rotated and shifted."""
    table = pd.read_csv(made / "phantom" / "positions.csv").set_index("seed")
    assert table["repositioned"].tolist() == [False, False, True]
    assert (table.loc[:1, ["x_mm", "y_mm", "z_mm", "turn_deg"]] == 0).all(axis=None)
    pose = table.loc[2]
    turn = np.deg2rad(pose["turn_deg"])
    for voxels in ("voxels_3_2_2", "grid"):
        still = made / "phantom" / ("" if voxels == "grid" else voxels)
        for path in (made / "phantom" / "moved" / "seed02" / voxels / "rois").glob("*.nii.gz"):
            one, other = (read_nifti(each) for each in (still / "rois" / path.name, path))
            (z, y, x), moved = (middle(mask) for mask in (one, other))
            expected = [
                z + pose["z_mm"],
                x * np.sin(turn) + y * np.cos(turn) + pose["y_mm"],
                x * np.cos(turn) - y * np.sin(turn) + pose["x_mm"],
            ]
            assert moved == pytest.approx(expected, abs=0.35 * max(one.grid.spacing)), path


def test_regions_contain_the_same_tissue_in_every_pose(made):
    """If regions or phantom did not follow, edges would be inside."""
    features = pd.read_csv(made / "features.csv")
    assert len(features) == 2 * 3 * 6
    for (protocol, roi), rows in features.groupby(["protocol", "roi"]):
        means = rows.set_index("seed")["original_firstorder_Mean"]
        assert means[2] == pytest.approx(means[:1].mean(), abs=8), (protocol, roi)


def test_only_boxes_are_made(made):
    image = read_nifti(made / "images" / "boxed" / "dose10" / "seed00.nii.gz")
    assert image.grid.spacing == pytest.approx(VOXELS["spacing_mm"]) and image.grid.shape == (32, 150, 150)
    assert 0.02 < np.mean(image.array != -1000) < 0.6


def test_common_job_makes_the_same_images(made, tmp_path):
    """Protocols with a common job share noise and filtered projections; each file has the same bytes as without it."""
    protocols = OVERLAY["protocols"]
    shared = {name: {**protocols[name], "job": "one"} for name in ("whole", "boxed")}
    folder = tmp_path / "results"
    shutil.copytree(made, folder, ignore=shutil.ignore_patterns("images", "features", "features.*", "reconstruct"))
    images = [f"images/{name}/dose10/seed{seed}.nii.gz" for name in shared for seed in ("00", "02")]
    overlay = {**OVERLAY, "protocols": {**protocols, **shared}}
    process = tiny(folder, *(folder / image for image in images), overlay=overlay)
    assert process.returncode == 0, process.stderr[-4000:]
    assert len(list((folder / "logs" / "reconstruct").glob("*.log"))) == 1
    for image in images:
        assert (folder / image).read_bytes() == (made / image).read_bytes(), image
