"""Figure scripts with a `snakemake` object among their globals, as Snakemake runs them."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pandas
import pytest
from robust_study import CUT_OFFS, robustness_table

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.io.files import read_csv, write_csv
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.statistics import ANY_PROTOCOL

SCRIPTS = Path(__file__).resolve().parents[2] / "workflow" / "scripts" / "figures"


class Named(dict):
    """Values accessible as keys and as attributes, as Snakemake's inputs and params."""

    __getattr__ = dict.__getitem__


@pytest.fixture
def run(tmp_path):
    """Function that runs one script and returns the paths of its PNG and PDF."""

    def run(name, inputs, **params):
        output = Named(png=str(tmp_path / "figures" / "f.png"), pdf=str(tmp_path / "figures" / "f.pdf"))
        fake = SimpleNamespace(
            input=Named(inputs), params=Named(params), output=output, threads=1, log=[str(tmp_path / "log")]
        )
        runpy.run_path(str(SCRIPTS / f"{name}.py"), init_globals={"snakemake": fake})
        return Path(output.png), Path(output.pdf)

    return run


def written(paths):
    png, pdf = paths
    return png.read_bytes().startswith(b"\x89PNG") and pdf.read_bytes().startswith(b"%PDF")


@pytest.fixture
def phantom_folder(make_phantom, tmp_path):
    phantom, masks = make_phantom(["liver_1", "aorta"])
    write_nifti(phantom, tmp_path / "image.nii.gz")
    for roi, mask in masks.items():
        write_nifti(Volume(mask.astype(np.uint8), phantom.grid), tmp_path / "rois" / f"{roi}.nii.gz")
    table = pandas.DataFrame(
        {
            "roi": list(masks),
            "tissue_class": ["liver", "vessel"],
            "label": [1, 2],
            "n_voxels": [int(mask.sum()) for mask in masks.values()],
            "mean_hu": [float(phantom.array[mask].mean()) for mask in masks.values()],
        }
    )
    write_csv(table, tmp_path / "rois.csv")
    return tmp_path


def test_rois(run, phantom_folder):
    inputs = {"image": phantom_folder / "image.nii.gz", "rois": phantom_folder / "rois.csv"}
    assert written(run("rois", inputs))


def test_scans(run, phantom_folder):
    image = phantom_folder / "image.nii.gz"
    inputs = {"phantom": image, "fbp": image, "sirt": image, "rois": phantom_folder / "rois.csv"}
    assert written(run("scans", inputs, titles={"fbp": "FBP", "sirt": "SIRT"}, noise={"dose10": 1e-6}))


@pytest.mark.parametrize(
    ("name", "params"),
    [
        (
            "noise_calibration",
            {"study_levels": {"main": 1e-4}, "measured": [{"label": "1 mGy", "variance_hu2": 674.0}]},
        ),
        (
            "stability_discrimination",
            {"threshold": 1.0, "seeds": 10, "settings": "", "noise": {}}
            | dict.fromkeys(("measured_acquisitions", "recording")),
        ),
        ("overlap", {}),
        ("pca", {"title": "SIRT"}),
        ("trust_map", {"cut_offs": CUT_OFFS}),
    ],
)
def test_tables(run, tmp_path, calibration, stability, controls, overlap, make_pca, name, params):
    tables = {
        "noise_calibration": calibration,
        "stability_discrimination": stability,
        "overlap": overlap,
        "pca": make_pca(),
        "trust_map": robustness_table(),
    }
    write_csv(tables[name], tmp_path / "table.csv")
    intervals = stability[["feature"]].assign(change=ANY_PROTOCOL, ci95_low=1.0, ci95_high=99.0)
    write_csv(intervals, tmp_path / "trust.csv")
    write_csv(controls, tmp_path / "controls.csv")
    inputs = {one: tmp_path / f"{one}.csv" for one in ("table", "trust", "controls")}
    heights = []
    for trial in (False, True):
        paths = run(name, inputs, trial=trial, **params)
        assert written(paths)
        heights.append(len(matplotlib.image.imread(paths[0])))
    assert heights[1] > heights[0]  # in the line with the reason


def test_measured_scores_are_shown_with_simulated_ones(run, tmp_path, controls):
    from virtual_phantom.features.names import family

    scores = read_csv(RESOURCES / "ct_phantom4radiomics_scores.csv")
    write_csv(scores.assign(family=scores["feature"].map(family)), tmp_path / "table.csv")
    intervals = scores[["feature"]].assign(change=ANY_PROTOCOL, ci95_low=1.0, ci95_high=99.0)
    write_csv(intervals, tmp_path / "trust.csv")
    write_csv(controls, tmp_path / "controls.csv")
    paths = run(
        "stability_discrimination",
        {one: tmp_path / f"{one}.csv" for one in ("table", "trust", "controls")},
        threshold=1.0,
        measured_acquisitions="all",
        recording=None,
        seeds=10,
        settings="",
        trial=False,
        noise={"met": None},
    )
    assert written(paths)


def test_bad_input_is_one_line_and_exit_code_1(run, tmp_path, capsys):
    (tmp_path / "table.csv").write_text("n_top,percent\n")
    with pytest.raises(SystemExit) as stop:
        run("overlap", {"table": tmp_path / "table.csv"}, trial=False)
    assert stop.value.code == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "figures").exists()
