"""The workflow itself: every shipped config plans, the tiny study runs, mistakes stop it with one clear line."""

import shutil
import subprocess
import sys
from pathlib import Path

import astra
import nibabel
import numpy as np
import pandas as pd
import pytest
import SimpleITK as sitk
import yaml

ROOT = Path(__file__).resolve().parents[2]
TINY = ROOT / "config" / "tiny.yaml"
FIGURES = (
    "rois",
    "scans",
    "noise_calibration",
    "stability_discrimination",
    "overlap",
    "pca_sirt",
    "pca_fbp",
    "pca_multicentre",
)


def snakemake(*arguments, cores=2):
    """Run snakemake in the repository; returns the finished process, output and errors as text."""
    command = [sys.executable, "-m", "snakemake", "--cores", str(cores), "--nolock", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)


def tiny(folder, *targets, cores=2, overlay=None):
    """The tiny study into `folder`; `overlay` is a dict of config keys on top of it."""
    files = [TINY]
    if overlay is not None:
        folder.parent.mkdir(parents=True, exist_ok=True)
        files.append(folder.parent / "overlay.yaml")
        files[-1].write_text(yaml.safe_dump(overlay))
    # Targets go first: --config and --configfile would swallow them.
    return snakemake(*targets, "--configfile", *files, "--config", f"results_dir={folder}", cores=cores)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The tiny study, run for real on two cores."""
    folder = tmp_path_factory.mktemp("study") / "results"
    process = tiny(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder


@pytest.mark.parametrize("config", sorted(path.name for path in (ROOT / "config").glob("*.yaml")))
def test_every_shipped_config_plans(config, tmp_path):
    if config == "abdomen.yaml" and not (ROOT / "../shared/real/abdomen_ct").exists():
        pytest.skip("the real abdominal CT is not beside this checkout")
    process = snakemake(
        "-n", "-q", "rules", "--configfile", f"config/{config}", "--config", f"results_dir={tmp_path}/r"
    )
    assert process.returncode == 0, process.stderr[-2000:]
    assert "figure_stability_discrimination" in process.stdout


def test_every_figure_and_table_is_made(study):
    for figure in FIGURES:
        assert (study / "figures" / f"{figure}.png").stat().st_size > 10_000
        assert (study / "figures" / f"{figure}.pdf").read_bytes().startswith(b"%PDF")
    for table in (
        "noise_calibration",
        "stability",
        "top_features",
        "overlap",
        "pca_sirt",
        "pca_fbp",
        "pca_multicentre",
    ):
        assert len(pd.read_csv(study / "tables" / f"{table}.csv")) > 0
    features = pd.read_csv(study / "features.csv")
    # 4 groups at dose10, the same 4 at dose10_plus12, and two SIRT ones at double: 3 repeats and 6 ROIs of each.
    assert len(features) == (4 + 4 + 2) * 3 * 6
    assert len(pd.read_csv(study / "tables" / "stability.csv")) == 86


def test_images_lie_on_the_phantom_in_every_reader(study):
    phantom = nibabel.load(study / "phantom" / "image.nii.gz")
    path = study / "images" / "sirt_300" / "dose10" / "seed00.nii.gz"
    image = nibabel.load(path)
    np.testing.assert_allclose(image.affine, phantom.affine)
    np.testing.assert_allclose(image.get_sform(), image.get_qform(), atol=1e-5)
    assert image.get_data_dtype() == np.int16
    assert sitk.ReadImage(str(path)).GetSpacing() == pytest.approx((3.75, 3.75, 4.0))
    body = phantom.get_fdata() > -200
    assert abs(np.median(image.get_fdata()[body] - phantom.get_fdata()[body])) < 20


def test_seeds_make_different_images_with_the_same_mean(study):
    folder = study / "images" / "fbp_300" / "dose10"
    stack = np.stack([nibabel.load(folder / f"seed{seed:02d}.nii.gz").get_fdata() for seed in range(3)])
    assert (stack.std(0) > 0).mean() > 0.5
    assert np.corrcoef((stack[0] - stack[2]).ravel(), (stack[1] - stack[2]).ravel())[0, 1] == pytest.approx(
        0.5, abs=0.1
    )


def test_noise_variance_is_linear_in_the_noise_level(study):
    table = pd.read_csv(study / "tables" / "noise_calibration.csv").query("roi == 'all'")
    assert np.corrcoef(table["noise_level"], table["variance_hu2"])[0, 1] ** 2 > 0.98


def test_noisy_projections_are_cleared_away(study):
    assert not list((study / "projections").rglob("seed*.h5"))
    assert not list(study.rglob(".partial-*"))


def test_a_second_run_does_nothing(study):
    process = tiny(study)
    assert process.returncode == 0
    assert "Nothing to be done" in process.stderr + process.stdout


def test_a_new_protocol_runs_its_own_jobs_only(study, tmp_path):
    """Adding sirt_180 plans its own acquisitions and what all protocols share, and touches no other protocol."""
    overlay = tmp_path / "more.yaml"
    overlay.write_text("protocols:\n  sirt_180:\n    algorithm: sirt\n    projections: 180\n    group: 9\n")
    process = snakemake("-n", "--configfile", TINY, overlay, "--config", f"results_dir={study}")
    assert process.returncode == 0, process.stderr[-2000:]
    wildcards = [line for line in process.stdout.splitlines() if line.startswith("    wildcards: ")]
    scans = [line for line in wildcards if "protocol=" in line or "geometry=" in line]
    assert any("protocol=sirt_180" in line for line in scans)
    assert all("sirt_180" in line or "views180" in line for line in scans), scans
    assert "rule phantom:" not in process.stdout


def test_one_core_makes_the_same_features(study, tmp_path):
    """features.csv byte for byte, from nothing, with one core instead of two."""
    process = tiny(tmp_path / "r", tmp_path / "r" / "features.csv", cores=1)
    assert process.returncode == 0, process.stderr[-4000:]
    assert (tmp_path / "r" / "features.csv").read_bytes() == (study / "features.csv").read_bytes()


PROTOCOL = {"algorithm": "sirt", "projections": 150, "group": 1}


@pytest.mark.parametrize(
    "overlay, message",
    [
        ({"protocls": {}}, "unknown key 'protocls' in config; did you mean 'protocols'"),
        ({"protocols": {"sirt_150": PROTOCOL | {"projections": 0}}}, "0 is less than the minimum of 1"),
        ({"protocols": {"sirt_150": PROTOCOL | {"projections": -5}}}, "-5 is less than the minimum of 1"),
        ({"protocols": {"sirt_150": PROTOCOL | {"algorithm": "art"}}}, "is 'art'; use one of sirt, fbp"),
        ({"engine": "astra_cuda"}, "astra_cuda has no adjoint"),
        ({"engine": "astra_cuda", "reconstruction": {"sirt": {"backprojector": "voxel"}}}, "needs a CUDA device"),
    ],
)
def test_mistakes_in_the_config(overlay, message, tmp_path):
    if message == "needs a CUDA device" and astra.use_cuda():
        pytest.skip("there is a CUDA device here")
    process = tiny(tmp_path / "r", "-n", overlay=overlay)
    errors = [line for line in (process.stderr + process.stdout).splitlines() if line.startswith("Error:")]
    assert process.returncode == 1
    assert len(errors) == 1 and message in errors[0]
    assert "Traceback" not in process.stderr
    assert not (tmp_path / "r").exists()


def test_a_missing_ct_stops_the_phantom_rule(tmp_path):
    ct = {"image": f"{tmp_path}/none.nii.gz", "rois": [{"name": "a", "tissue_class": "b", "file": "m.nii.gz"}]}
    process = tiny(tmp_path / "r", overlay={"phantom": {"source": "ct", "ct": ct}})
    assert process.returncode == 1
    assert f"Error: {tmp_path}/none.nii.gz" in process.stderr, process.stderr[-3000:]
    assert not (tmp_path / "r" / "phantom" / "image.nii.gz").exists()


def test_a_truncated_acquisition_is_named(study, tmp_path):
    """A clean projection file cut in half is refused by name, and nothing is made from it."""
    copy = tmp_path / "r"
    shutil.copytree(study, copy)
    clean = copy / "projections" / "views150" / "clean.h5"
    clean.write_bytes(clean.read_bytes()[: clean.stat().st_size // 2])
    target = copy / "images" / "sirt_150" / "double" / "seed00.nii.gz"
    target.unlink()
    process = tiny(copy, target)
    assert process.returncode == 1
    assert "clean.h5: not a complete" in process.stderr, process.stderr[-3000:]
    assert not target.exists()
