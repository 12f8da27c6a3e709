"""The workflow: every shipped configuration can be planned, the tiny study runs, and mistakes stop it with one line."""

import base64
import hashlib
import json
import re
import shutil

import astra
import nibabel
import numpy as np
import pandas as pd
import pytest
import SimpleITK as sitk
import yaml
from browser import outside_resources
from phantom_files import ball, write_nifti_array
from published_files import with_its_ct
from test_limits import plan_of
from workflow_runs import BENEATH, ROOT, TINY, planned, snakemake, tiny

from virtual_phantom.io import exchange, volumes
from virtual_phantom.phantom.dicom_series import read_series
from virtual_phantom.phantom.masks import open_regions
from virtual_phantom.simulation.reconstruct import reconstruct
from virtual_phantom.study import analyses
from virtual_phantom.study.costs.jobs import study_jobs

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
TABLES = (
    "noise_calibration",
    "fixed_pattern",
    "stability",
    "stability_measures",
    "stable_features",
    "top_features",
    "trust",
    "overlap",
    "pca_sirt",
    "pca_fbp",
    "pca_multicentre",
)  # new outputs need no entry
TINY_STUDY = yaml.safe_load(TINY.read_text())
TINY_PLAN = plan_of(TINY_STUDY)
PROTOCOL = {"algorithm": "sirt", "projections": 150, "group": 1}


SCAN = {"trajectory": "circular", "source_to_isocentre_mm": 410.66, "source_to_detector_mm": 553.74, "columns": 560}
SCAN |= {
    "rows": 1,
    "column_pitch_mm": 0.2,
    "row_pitch_mm": 0.2,
    "views": 721,
    "views_per_rotation": 720,
    "start_angle_deg": 0,
    "direction": 1,
}
IMPORTED = {
    "recordings.yaml": {"tandem": "features", "dose_series": "features"},
    "htc2022.yaml": {"solid_disc": "projections", "ta": "projections", "tb": "projections"},
}


def recorded(folder, kind):
    """Substitute of an imported recording: planning only reads its recording.yaml."""
    folder.mkdir()
    (folder / "repeat").write_text("image,roi\n")
    content = {"name": folder.name, "kind": kind, "repeats": ["repeat"]}
    content |= {"scan": SCAN} if kind == "projections" else {}
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    return folder


# `study` makes the first one; test_plan_target.py plans three others, test_outputs.py the last one.
PLANNED_ELSEWHERE = {"tiny.yaml", "config.yaml", "paper.yaml", "recordings.yaml", "printed_phantom.yaml"}


@pytest.mark.parametrize("config", sorted({path.name for path in (ROOT / "config").glob("*.yaml")} - PLANNED_ELSEWHERE))
def test_every_shipped_config_can_be_planned(config, tmp_path):
    overlay = {"results_dir": f"{tmp_path}/r"}
    if config in IMPORTED:
        named = IMPORTED[config]
        overlay["recordings"] = {name: str(recorded(tmp_path / name, kind)) for name, kind in named.items()}
    if config == "htc2022.yaml":
        mask = tmp_path / "object.nii.gz"
        write_nifti_array(ball("bright").astype(np.uint8), mask)
        overlay["diagnosis"] = {"recordings": {name: {"object": {"mask": str(mask)}} for name in ("ta", "tb")}}
    if config == "proof.yaml":
        overlay["proof"] = {"seed": 1, "simulators": ["xcist"]}  # without Git and the other simulator
    if config == "multicentre.yaml":
        overlay["subset"] = "small"  # as in the command of its first lines
    (tmp_path / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    project = with_its_ct(tmp_path / "project") if config == "abdomen.yaml" else ROOT
    names = (*BENEATH.get(config, ()), config)
    settings = ("--configfile", *(f"config/{name}" for name in names), tmp_path / "overlay.yaml")
    process = snakemake("-n", "-q", "rules", *settings, project=project)
    assert process.returncode == 0, process.stderr[-2000:]
    assert "figure_stability_discrimination" in process.stdout


@pytest.fixture(scope="module")
def study_run(made_once):
    """Folder and output of the tiny study."""
    return made_once / "results", json.loads((made_once / "said").read_text())


@pytest.fixture(scope="module")
def study(study_run):
    """Folder of the tiny study, in which these tests continue."""
    return study_run[0]


def test_every_figure_and_table_is_made(study):
    for figure in FIGURES:
        assert (study / "figures" / f"{figure}.png").stat().st_size > 10_000
        assert (study / "figures" / f"{figure}.pdf").read_bytes().startswith(b"%PDF")
    tables = [path for output, known in analyses.tables(TINY_PLAN) for path in output.paths(**known)]
    assert {f"tables/{name}.csv" for name in TABLES} <= {*tables}
    for table in tables:
        assert len(pd.read_csv(study / table)) > 0
    features = pd.read_csv(study / "features.csv")
    # 4 groups at dose10, the same 4 at dose10_plus12, and two SIRT groups at double: 3 repeats and 6 ROIs each.
    assert len(features) == (4 + 4 + 2) * 3 * 6
    assert len(pd.read_csv(study / "tables" / "stability.csv")) == 86


def test_few_lines_report_the_progress(study_run):
    folder, lines = study_run
    jobs = len(study_jobs(TINY_PLAN, "cpu", rois=6))  # `all` is not counted
    stated = re.findall(r"^\d\d:\d\d:\d\d (\d+) of (\d+) jobs done(.*)$", lines, re.MULTILINE)
    first = rf"Jobs to do: {jobs}, .+ (s|min) on 2 cores.*\. Results: {folder}; logs: {folder}/logs"
    assert re.fullmatch(rf"\d\d:\d\d:\d\d {first}", lines.splitlines()[1]), lines[:2000]
    assert {int(total) for _, total, _ in stated} == {jobs}
    done = [int(number) for number, _, _ in stated]
    assert done == sorted(done) and done[0] == 0 and done[-1] == jobs
    assert re.fullmatch(r"; now: \w+ \(0 of \d+ done\).*", stated[0][2])
    assert re.fullmatch(rf" in \d+ (s|min)\. Start with {folder}/index\.html", stated[-1][2])
    left = r", (under|about|[\d.]+( s)? to) [\d.]+ (s|min) left; now: \w+ \("
    assert all(re.match(left, rest) for _, _, rest in stated[1:-1]), stated
    assert sum(" left" in rest for _, _, rest in stated[1:-1]) > len(stated[1:-1]) / 2
    assert len(lines.splitlines()) < 60 and "jobid" not in lines and "Job stats" not in lines


def test_every_job_has_written_its_own_log(study):
    """Its rule names the log; `default`, which only lists files, has none."""
    process = tiny(study, "--forceall", "-n")
    assert process.returncode == 0, process.stderr[-2000:]
    jobs = re.findall(r"^ *(?:local)?rule (\w+):$", process.stdout, re.MULTILINE)
    logs = re.findall(r"^ *log: (.+)$", process.stdout, re.MULTILINE)
    assert jobs.count("default") == 1 and len(set(logs)) == len(logs) == len(jobs) - 1
    assert {"phantom", "compile_kernels", "merge_features", "stability"} <= {*jobs}
    assert {f"figure_{name}" for name in FIGURES} <= {*jobs}
    assert [log for log in logs if not (ROOT / log).is_file()] == []


def test_parquet_has_the_content_of_csv_with_types(study):
    tables = [study / "features.csv", *(study / "tables").glob("*.csv")]
    assert len(tables) == len(analyses.tables(TINY_PLAN))
    for path in tables:
        table, csv = pd.read_parquet(path.with_suffix(".parquet")), pd.read_csv(path)
        assert list(table.columns) == list(csv.columns)
        pd.testing.assert_frame_equal(table.astype(csv.dtypes), csv, check_exact=True)
    features = pd.read_parquet(study / "features.parquet")
    assert features["seed"].dtype == features["n_voxels"].dtype == np.int64
    assert features["original_firstorder_Mean"].dtype == np.float64
    assert pd.api.types.is_string_dtype(features["settings_hash"])


def test_images_are_aligned_with_the_phantom_in_every_reader(study):
    phantom = nibabel.load(study / "phantom" / "image.nii.gz")
    path = study / "images" / "sirt_300" / "dose10" / "seed00.nii.gz"
    image = nibabel.load(path)
    np.testing.assert_allclose(image.affine, phantom.affine)
    np.testing.assert_allclose(image.get_sform(), image.get_qform(), atol=1e-5)
    assert image.get_data_dtype() == np.int16
    assert sitk.ReadImage(str(path)).GetSpacing() == pytest.approx((3.75, 3.75, 4.0))
    body = phantom.get_fdata() > -200
    assert abs(np.median(image.get_fdata()[body] - phantom.get_fdata()[body])) < 20


def test_pages_and_dicom_of_the_study(study, tmp_path):
    """Exported images are aligned with the NIfTI ones, and the report contains every figure and its provenance."""
    overlay = {"dicom": {"images": ["sirt_150/double/seed02"]}}
    process = tiny(study, "dicom", "report_page", overlay=overlay, config_folder=tmp_path)
    assert process.returncode == 0, process.stderr[-4000:]
    (series,) = (study / "dicom").glob("*/*/*/series")
    exported = read_series(series)
    image = volumes.read_nifti(study / "images" / "sirt_150" / "double" / "seed02.nii.gz")
    assert exported.grid.matches(image.grid)
    np.testing.assert_array_equal(exported.array, image.array)
    rois = pd.read_csv(study / "phantom" / "rois.csv")
    regions = open_regions(series.parent / "rois.dcm", exported.grid)
    assert [regions.mask(roi).sum() for roi in rois["roi"]] == rois["n_voxels"].tolist()
    page = (study / "report.html").read_text()
    assert outside_resources(page) == outside_resources((study / "viewer.html").read_text()) == []
    for figure in FIGURES:
        assert base64.b64encode((study / "figures" / f"{figure}.png").read_bytes()).decode() in page
    for path in (study / "tables").glob("*.csv"):
        assert hashlib.sha256(path.read_bytes()).hexdigest() in page
    assert (study / "viewer.html").stat().st_size < 15e6


def test_seeds_give_different_images_with_the_same_mean(study):
    folder = study / "images" / "fbp_300" / "dose10"
    stack = np.stack([nibabel.load(folder / f"seed{seed:02d}.nii.gz").get_fdata() for seed in range(3)])
    assert (stack.std(0) > 0).mean() > 0.5
    assert np.corrcoef((stack[0] - stack[2]).ravel(), (stack[1] - stack[2]).ravel())[0, 1] == pytest.approx(
        0.5, abs=0.1
    )


def test_noise_variance_is_linear_in_the_noise_level(study):
    table = pd.read_csv(study / "tables" / "noise_calibration.csv").query("roi == 'all ROIs'")
    assert np.corrcoef(table["noise_level"], table["variance_hu2"])[0, 1] ** 2 > 0.98


def test_no_partial_file_is_left(study):
    assert not list((study / "projections").rglob("seed*.h5"))
    assert not list(study.rglob(".partial-*"))


def test_stored_projections_are_those_of_the_images(study, tmp_path):
    """The image from a stored file of counts equals the one of the study, voxel by voxel."""
    file = study / "projections" / "views150" / "dose10" / "seed01.h5"
    process = tiny(study, file, overlay={"keep_projections": True}, config_folder=tmp_path)
    assert process.returncode == 0, process.stderr[-2000:]
    counts, geometry = exchange.read_counts(file)
    file.unlink()
    image = volumes.read_nifti(study / "images" / "fbp_150" / "dose10" / "seed01.nii.gz")
    # The number of lanes is that of the study, because it may change the order of summation.
    lanes = max(int(path.stem.split("_")[1]) for path in (study / "logs" / "kernels").glob("fbp_*.txt"))
    again, *_ = reconstruct(
        np.repeat(counts.line_integrals(0.5)[None], lanes, axis=0),
        geometry,
        image.grid,
        "fbp",
        TINY_PLAN.study.reconstruction.fbp,
        engine="cpu",
        mu_water_per_mm=0.0193,
    )
    np.testing.assert_array_equal(again.array, image.array)


def test_common_random_numbers_give_noise_levels_the_same_noise(study, tmp_path):
    files = [study / "projections" / "views150" / level / "seed01.h5" for level in ("dose10", "double")]
    overlay = {"keep_projections": True, "noise": {"draws": "common"}}
    process = tiny(study, *files, overlay=overlay, config_folder=tmp_path)
    assert process.returncode == 0, process.stderr[-2000:]
    clean, _ = exchange.read_line_integrals(study / "projections" / "views150" / "clean.h5")
    noise = [exchange.read_counts(file)[0].line_integrals(0.5) - clean for file in files]
    for file in files:
        file.unlink()
    assert np.corrcoef(*(one.ravel() for one in noise))[0, 1] > 0.999  # 0 for independent noise


def test_second_run_does_nothing(study):
    process = tiny(study)
    assert process.returncode == 0
    assert "Nothing to be done" in process.stderr + process.stdout


def analysis_rules(**changes):
    """Rules of the tiny study after feature extraction, with these changes of its analyses."""
    return {job.outputs[0].rule for job in analyses.jobs(plan_of(TINY_STUDY, {"analyses": changes}))}


AFTER_STABILITY = {
    "index_page",
    "trust",
    "stability",
    "stability_measures",
    "parquet",
    "top_features",
    "overlap",
    "figure_overlap",
    "figure_stability_discrimination",
    "default",
}
STABILITY_RULES = (
    AFTER_STABILITY | {"extraction_settings"} | analysis_rules() - analysis_rules(stability=None)
)  # and new ones
BEFORE_FEATURES = {"figure_rois", "figure_scans", "noise_calibration", "figure_noise_calibration"}  # without features
AFTER_FEATURES = STABILITY_RULES | analysis_rules() - BEFORE_FEATURES


@pytest.mark.parametrize(
    "settings, projected",
    [({"projections": 180}, ["geometry=views180, scan=clean"]), ({"algorithm": "fbp"}, [])],
    ids=["of a new geometry", "of a geometry that is there"],
)
def test_new_protocol_only_runs_its_own_jobs(study, tmp_path, settings, projected):
    """And common outputs: the merged table, the statistics, their figures, and kernels for its bundle's size."""
    overlay = {"protocols": {"new": PROTOCOL | settings | {"group": 9}}}
    jobs = planned(tiny(study, "-n", overlay=overlay, config_folder=tmp_path))
    own_jobs = {rule for rule in jobs if rule.startswith(("reconstruct", "extract"))}
    assert own_jobs and all(one.startswith("protocol=new") for rule in own_jobs for one in jobs[rule])
    assert jobs.pop("project", []) == projected
    assert jobs.keys() - own_jobs <= AFTER_FEATURES | {"compile_kernels"}


def test_threshold_only_changes_the_statistics(study, tmp_path):
    jobs = planned(tiny(study, "-n", overlay={"statistics": {"threshold": 1.5}}, config_folder=tmp_path))
    assert AFTER_STABILITY <= set(jobs) <= STABILITY_RULES


def test_noise_model_keeps_the_line_integrals(study, tmp_path):
    jobs = planned(tiny(study, "-n", overlay={"noise": {"model": "physical"}}, config_folder=tmp_path))
    assert not {"phantom", "project", "compile_kernels"} & set(jobs)
    assert sum(len(jobs[rule]) for rule in jobs if rule.startswith("extract")) == 4


def test_solver_setting_keeps_the_other_algorithm(study, tmp_path):
    jobs = planned(tiny(study, "-n", overlay={"reconstruction": {"sirt": {"terms": 30}}}, config_folder=tmp_path))
    made = [wildcard for rule, wildcards in jobs.items() if rule.startswith("reconstruct") for wildcard in wildcards]
    assert made and all("protocol=sirt_" in one for one in made)
    assert not {"phantom", "project"} & set(jobs)


def test_another_noise_level_keeps_existing_images(study, tmp_path):
    """Five repeats exceed the bundle of the levels before it, so they have their own jobs."""
    overlay = {
        "noise": {"levels": {"loud": {"A": 5.0e-5, "repeats": 5}}},
        "analyses": {"pca": {"fbp": {"noise": ["dose10", "dose10_plus12", "loud"]}}},
    }
    jobs = planned(tiny(study, "-n", overlay=overlay, config_folder=tmp_path))
    extracted = [wildcard for rule, wildcards in jobs.items() if rule.startswith("extract") for wildcard in wildcards]
    assert sorted(extracted) == ["protocol=fbp_150", "protocol=fbp_300"]


def test_edited_mask_is_detected(tmp_path):
    z, y, x = np.mgrid[-6:6, -20:20, -20:20]
    body, core = np.hypot(x, y) < 15, np.hypot(x, y) < 5
    affine = np.diag([4.0, 4.0, 4.0, 1.0])
    for name, array in (("ct", np.where(body, 20, -1000)), ("core", core), ("rim", body & ~core)):
        nibabel.save(nibabel.Nifti1Image(array.T.astype(np.int16), affine), tmp_path / f"{name}.nii.gz")
    rois = [
        {"name": name, "tissue_class": name, "file": str(tmp_path / f"{name}.nii.gz"), "margin_mm": 4}
        for name in ("core", "rim")
    ]
    grid = {"shape": [12, 40, 40], "spacing_mm": [4.0, 4.0, 4.0]}
    phantom = {"source": "ct", "ct": {"image": str(tmp_path / "ct.nii.gz"), "rois": rois}}
    overlay = {"phantom": phantom, "grid": grid, "measured": {"overlay": False}}
    folder = tmp_path / "r"
    target = folder / "phantom" / "image.nii.gz"
    process = tiny(folder, target, overlay=overlay)
    assert process.returncode == 0, process.stderr[-3000:]
    assert not planned(tiny(folder, target, "-n", overlay=overlay))
    smaller = (body & (np.hypot(x, y) > 7)).T.astype(np.int16)
    nibabel.save(nibabel.Nifti1Image(smaller, affine), tmp_path / "rim.nii.gz")
    assert set(planned(tiny(folder, target, "-n", overlay=overlay))) == {"phantom"}


def without(study, copy, *protocols):
    """A copy of the study without the outputs of one geometry and these protocols, and without the merged table."""
    shutil.copytree(study, copy)
    shutil.rmtree(copy / "projections" / "views150")
    for kind in ("images", "features"):
        for protocol in protocols:
            shutil.rmtree(copy / kind / protocol)
    (copy / "features.csv").unlink()
    return copy


def made_first(folder, *protocols):
    """These protocols in the order in which their images were made."""
    return sorted(protocols, key=lambda name: (folder / "images" / name / "dose10" / "seed00.nii.gz").stat().st_mtime)


def test_one_core_and_another_order_give_the_same_features(study, tmp_path):
    """Compare features.csv byte for byte after one core repeats all outputs of one geometry with both algorithms.

    The order of the jobs is reversed.
    """
    protocols = ("sirt_150", "fbp_150")
    copy = without(study, tmp_path / "r", *protocols)
    order = made_first(study, *protocols)
    process = tiny(copy, copy / "features.csv", "--prioritize", copy / first_table(order[-1]), cores=1)
    assert process.returncode == 0, process.stderr[-4000:]
    assert made_first(copy, *protocols) == order[::-1]
    assert (copy / "features.csv").read_bytes() == (study / "features.csv").read_bytes()


def first_table(protocol):
    return f"features/{protocol}/dose10/seed00.csv"


def test_four_cores_and_no_compiled_kernels_give_the_same_images_and_features(study, tmp_path):
    """Compare one protocol's images and tables byte for byte: two jobs of two threads, all kernels compiled again."""
    copy, kernels = without(study, tmp_path / "r", "fbp_150"), tmp_path / "kernels"
    shutil.rmtree(copy / "logs" / "kernels")
    targets = [copy / "features" / "fbp_150" / noise / "seed00.csv" for noise in ("dose10", "dose10_plus12")]
    # Settings of a notebook or a container, none of which can be used.
    nowhere = str(copy / "features.csv" / "x")
    environment = {"NUMBA_CACHE_DIR": str(kernels), "TMPDIR": nowhere, "XDG_CACHE_HOME": nowhere}
    environment |= {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "PYTHONIOENCODING": "ascii"}
    process = tiny(copy, *targets, cores=4, overlay={"threads": 2}, config_folder=tmp_path, environment=environment)
    assert process.returncode == 0, process.stderr[-4000:]
    assert list(kernels.glob("*.kernel"))
    made = [copy / "projections" / "views150" / "clean.h5"]
    made += [*copy.glob("images/fbp_150/*/*.nii.gz"), *copy.glob("features/fbp_150/*/*.csv")]
    assert len(made) == 1 + 2 * 3 + 2 * 3
    for path in made:
        assert path.read_bytes() == (study / path.relative_to(copy)).read_bytes(), path


@pytest.mark.parametrize(
    "overlay, messages",
    [
        (
            {
                "protocls": {},
                "protocols": {
                    "sirt_150": PROTOCOL | {"projections": -5},
                    "sirt_200": PROTOCOL | {"algorithm": "art"},
                },
            },
            [
                "Error: 3 mistakes",
                "unknown key 'protocls' in config; did you mean 'protocols'",
                "is 'art'; use one of sirt, fbp",
                "-5 is less than the minimum of 1",
            ],
        ),
        ({"dicom": {"images": ["sirt_150/none/seed00"]}}, ["sirt_150/none/seed00, which the study does not make"]),
        ({"engine": "astra_cuda"}, ["astra_cuda has no adjoint"]),
        ({"engine": "astra_cuda", "reconstruction": {"sirt": {"backprojector": "voxel"}}}, ["needs a CUDA device"]),
    ],
)
def test_mistakes_in_the_config(overlay, messages, tmp_path):
    """One run names all of them in a line each (tests/test_config.py has more)."""
    if messages == ["needs a CUDA device"] and astra.use_cuda():
        pytest.skip("there is a CUDA device here")
    process = tiny(tmp_path / "r", "-n", overlay=overlay)
    lines = (process.stderr + process.stdout).splitlines()
    assert process.returncode == 1
    assert sum(line.startswith("Error:") for line in lines) == 1
    first = next(number for number, line in enumerate(lines) if line.startswith("Error:"))
    listed = lines[first : first + len(messages)]
    for message in messages:  # one line each, in any order within a section
        assert sum(message in line for line in listed) == 1, lines
    assert "Traceback" not in process.stderr
    assert not (tmp_path / "r").exists()


def test_missing_ct_stops_before_any_job(tmp_path):
    ct = {"image": f"{tmp_path}/none.nii.gz", "rois": [{"name": "a", "tissue_class": "b", "file": "m.nii.gz"}]}
    overlay = {"phantom": {"source": "ct", "ct": ct}, "measured": {"overlay": False}}
    target = tmp_path / "r" / "phantom" / "image.nii.gz"
    process = tiny(tmp_path / "r", target, overlay=overlay)
    assert process.returncode == 1
    missing = f"phantom.ct.image: {tmp_path}/none.nii.gz: no such file; give the path of a NIfTI image"
    assert missing in process.stderr, process.stderr[-3000:]
    assert "Jobs to do" not in process.stderr + process.stdout and not target.exists()


def test_truncated_acquisition_is_named(study, tmp_path):
    """A clean projection file cut in half is rejected by name, and no output is made from it."""
    copy = tmp_path / "r"
    shutil.copytree(study, copy)
    clean = copy / "projections" / "views150" / "clean.h5"
    clean.write_bytes(clean.read_bytes()[: clean.stat().st_size // 2])
    target = copy / "images" / "sirt_150" / "double" / "seed00.nii.gz"
    target.unlink()
    process = tiny(copy, target)
    assert process.returncode == 1
    assert "clean.h5: is not as it was written" in process.stderr, process.stderr[-3000:]
    last = process.stderr.splitlines()[-1]
    images = f"{copy}/images/sirt_150"
    levels = ("dose10", "dose10_plus12", "double", "quadruple")
    acquisitions = ", ".join(f"{images}/{level}/seed00 to seed02" for level in levels)
    assert last.startswith(f"Failed: reconstruct of {acquisitions}: {clean}: is not as it was written")
    assert last.endswith(".log)") and "; " in last
    assert not target.exists()
