"""The printed phantom's study with one command, from scans on an S3 service to every figure.

The scans are simulated substitutes of the public ones, with known truth.
"""

import nibabel
import numpy as np
import pandas as pd
import public_files
import pytest
import SimpleITK as sitk
import yaml
from from_nothing import TANDEM, substituted_scans
from pages import share_kernels
from radiomics.featureextractor import RadiomicsFeatureExtractor
from test_fetch import PLACE
from workflow_runs import ROOT, snakemake

from virtual_phantom.features.names import VARIANCE

NAMES = ("801", "802")
PHANTOM = TANDEM | {"groups": [8], "acquisitions": [1, 2]}
COMPARED = TANDEM | {"groups": [4, 8], "acquisitions": [11, 12]}
LEVELS = {"dose10": 2.0e-5, "double": 6.0e-5, "quadruple": 12.0e-5}
MEETS = {"recording": "printed_phantom", "where": {"group": 8}, "rois": ["cyst_1"], "protocol": "group_8"}
SMALL = {  # one figure of each kind with scans; group 8 at the scans' own voxels and with their noise
    "noise": {
        "levels": {name: {"A": A, "repeats": 3} for name, A in LEVELS.items()}
        | {"dose10_plus12": None, "met": {"repeats": 2, "meets": MEETS}},
    },
    "reconstruction": {"sirt": {"iterations": 20, "terms": 5}},
    "protocols": {
        "sirt_300": None,
        "fbp_300": None,
        "group_8": {
            "algorithm": "fbp",
            "projections": 150,
            "kernel": {"mtf50_per_cm": 0.7, "mtf10_per_cm": 1.1},
            "voxels": {"spacing_mm": [4.0, 3.75, 3.75], "thickness_mm": 4.0},
        },
    },
    "analyses": {
        "optimal": None,
        "extraction": None,
        "noise_calibration": {"protocols": ["group_8"]},
        "pca": {
            "sirt": None,
            "multicentre": None,
            "fbp": {"protocols": ["fbp_150"], "noise": ["dose10"], "recordings": ["printed_phantom"]},
        },
        "comparison": {
            "group_8": {"protocol": "group_8", "noise": "met"},
            "group_4": None,
            "group_3": None,
        },
    },
    "diagnosis": {"comparisons": []},
    "results_dir": "results",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The project, the command's output, and the scanned objects."""
    folder = tmp_path_factory.mktemp("nothing")
    with substituted_scans(folder, PHANTOM, COMPARED) as (project, settings, variables, truth):
        share_kernels(ROOT, project)
        settings = SMALL | settings | {"grid": settings["grid"] | {"oversampling": 2}}
        (project / "mine.yaml").write_text(yaml.safe_dump(settings))
        files = ("config/printed_phantom.yaml", "config/tiny.yaml", "mine.yaml")
        environment = variables | {"PYTHONPATH": str(project / "workflow" / "lib")}
        process = snakemake("--configfile", *files, project=project, environment=environment, timeout=1800)
        yield project, process, truth


def test_one_command_makes_every_figure(made):
    project, process, _ = made
    output = process.stdout + process.stderr
    assert process.returncode == 0, output[-3000:]
    assert "6 CT and 6 SEG series" in output
    assert len(list((project / "results" / "logs" / "fetch").glob("*.log"))) == 6
    figures = project / "results" / "figures"
    expected = {"rois", "stability_discrimination", "overlap", "overlap_printed_phantom", "pca_fbp"}
    expected |= {"comparison_group_8", "noise_calibration", "trust_map"}
    assert {path.stem for path in figures.glob("*.png")} == expected
    assert (project / "results" / "index.html").stat().st_size > 0


def test_measured_and_simulated_rows_have_the_same_regions_and_number(made):
    project, _, _ = made
    cells = pd.read_csv(project / "results/tables/comparison_group_8.csv")
    assert cells["roi"].nunique() == 6 and len(cells) == 6 * 86
    assert set(cells["n_simulated"]) == set(cells["n_recorded"]) == {2}
    points = pd.read_csv(project / "results/tables/pca_fbp.csv")
    # A marker for each simulated image, and for each group of measured ones.
    assert points["source"].value_counts().to_dict() == {"simulated": 3 * 6, "measured": 2 * 6}


def test_noise_level_matches_the_scans_at_their_own_voxels(made):
    """Interpolated on a line of three levels, and simulated again."""
    project, _, _ = made
    (level,) = pd.read_csv(project / "results/tables/matched_noise.csv").to_dict("records")
    assert (level["noise"], level["protocol"]) == ("met", "group_8")
    assert not level["extrapolated"] and level["A_standard_error"] < 0.1 * level["A"]
    assert level["ratio"] == pytest.approx(1, abs=0.2)  # for two repeats, at an A that is known to 7 %
    cells = pd.read_csv(project / "results/tables/comparison_group_8.csv")
    variance = cells[(cells["feature"] == VARIANCE) & (cells["roi"] == "cyst_1")].iloc[0]
    assert variance["mean_recorded"] == pytest.approx(level["recorded_variance_hu2"])
    assert variance["mean_simulated"] == pytest.approx(level["simulated_variance_hu2"])


def test_phantom_is_the_mean_of_the_scans(made):
    project, _, (phantom, images) = made
    assert sorted(path.name for path in (project / PLACE).iterdir()) == sorted(images)
    table = pd.read_csv(project / "results/public_scans/scans.csv", dtype={"scan": str})
    assert table["scan"].tolist() == list(NAMES) and table["largest_mm"].max() < 0.2
    repeats = np.stack([images[name].array for name in NAMES]).astype(float)
    inside = np.any([roi.mask for roi in phantom.rois], axis=0)
    noise = np.sqrt(repeats[:, inside].var(axis=0, ddof=1).mean())
    np.testing.assert_allclose(table["noise_hu"], noise, rtol=0.01)
    np.testing.assert_allclose(table["remaining_noise_hu"], noise / len(NAMES) ** 0.5, rtol=0.01)

    rois = pd.read_csv(project / "results/phantom/rois.csv").set_index("roi")
    mean = repeats.mean(axis=0)
    assert list(rois.index) == ["normal_1", "normal_2", "cyst_1", "cyst_2", "hemangioma", "metastasis"]
    for roi in phantom.rois:
        assert rois.loc[roi.name, "tissue_class"] == roi.tissue_class
        # Another grid: interpolation over half a voxel, at most.
        assert rois.loc[roi.name, "n_voxels"] == pytest.approx(roi.mask.sum(), rel=0.35)
        assert rois.loc[roi.name, "mean_hu"] == pytest.approx(mean[roi.mask].mean(), abs=6)
    own_blur = pd.read_csv(project / "results/public_scans/own_blur.csv").fillna({"region": ""})
    own_blur = own_blur.set_index(["what", "region"])
    assert (project / "results/public_scans/sharp.nii.gz").exists()
    resolution = own_blur.loc[("mtf_half_per_mm", "")]
    assert resolution["without_own_blur"] > 1.1 * resolution["of_the_mean"]
    # Slices of 1 mm in the list; SD of a Gaussian of the same width at half its height.
    assert own_blur.loc[("blur_along_z_mm", ""), "of_the_mean"] == pytest.approx(0.4247, abs=1e-4)
    by_segment = dict(zip(public_files.SEGMENTS, rois.index, strict=True))
    masks = {roi.name: roi.mask for roi in phantom.rois}
    for segment, name in by_segment.items():
        assert own_blur.loc[("mean_hu", segment), "of_the_mean"] == pytest.approx(mean[masks[name]].mean(), abs=0.1)
    image = nibabel.load(project / "results/phantom/image.nii.gz").get_fdata()
    assert image.min() == -1000 and (image[0] == -1000).all() and (image[:, 0] == -1000).all()


def by_hand(image, mask, spacing):
    """Features by a direct call of pyradiomics on the written image."""
    extractor = RadiomicsFeatureExtractor(binWidth=25)
    images = [sitk.GetImageFromArray(one) for one in (image.astype(np.float32), mask.astype(np.uint8))]
    for one in images:
        one.SetSpacing(spacing)
    return extractor.execute(*images)


def test_features_of_the_other_scans_are_two_recordings(made):
    """In three dimensions, and in two like the published table: largest section, stored values, pixels of 1."""
    project, _, (phantom, images) = made
    table = pd.read_csv(project / "results/recordings/printed_phantom/features.csv")
    assert len(table) == 4 * 6 and set(table["image"]) == {"scan411", "scan412", "scan811", "scan812"}
    assert set(table["group"]) == {4, 8} and set(table["acquisition"]) == {11, 12}
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


def test_invalid_region_is_one_line(made):
    project, _, _ = made
    rois = yaml.safe_load((ROOT / "config/printed_phantom.yaml").read_text())["phantom"]["ct"]["rois"]
    rois[2]["label"] = "cyst_1"
    (project / "wrong.yaml").write_text(yaml.safe_dump({"phantom": {"ct": {"rois": rois}}}))
    files = ("config/printed_phantom.yaml", "mine.yaml", "wrong.yaml")
    process = snakemake("results/phantom/image.nii.gz", "--configfile", *files, project=project, cores=1)
    output = process.stdout + process.stderr
    assert process.returncode == 1 and "Traceback" not in output
    (error,) = [line for line in output.splitlines() if line.startswith("Error:")]
    assert "cyst_1 has the label cyst_1, which is not in public_scans.regions; did you mean 'cyst1'?" in error
