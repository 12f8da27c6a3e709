"""Every mistake of tests/mistakes.yaml gives its message, which states what is wrong and what to do."""

import copy
import re
import subprocess
import sys
from pathlib import Path

import h5py
import nibabel
import numpy as np
import pandas as pd
import phantom_files
import pytest
import recording_folders
import warm
import yaml

from virtual_phantom.base.errors import InputError, InputErrors
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.config.config import complete, read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.public_scans import PublicScans
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.features import tables
from virtual_phantom.features.names import FEATURES
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import ct
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.recordings.importers.projections import import_projections
from virtual_phantom.recordings.public_scans import fetch
from virtual_phantom.recordings.public_scans.files import find_scans
from virtual_phantom.recordings.public_scans.table import select_scans
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.simulation.project import read_diagnosed_physics
from virtual_phantom.study.checks.preflight import problems

ROOT = Path(__file__).resolve().parents[1]

PAGE = (ROOT / "docs" / "how-to" / "mistakes.md").read_text(encoding="utf-8")
SECTION = re.compile(r"^## (.+?)\n(?:(?!^##).)*?^<!-- message -->\n```\n(.+?)\n```$", re.MULTILINE | re.DOTALL)
EXPLAINED = dict(SECTION.findall(PAGE))
MESSAGES = yaml.safe_load((ROOT / "tests" / "mistakes.yaml").read_text(encoding="utf-8"))
DEFAULT = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
GRID = Grid((14, 40, 48), (3.0, 2.0, 2.0))
MU_WATER_PER_MM = 0.0193


VOXELS = {"spacing_mm": [1.0, 0.7, 0.7], "thickness_mm": 2.0}


def configured(*changes):
    """Check the default configuration with (dotted key, value) set in it."""
    config = copy.deepcopy(DEFAULT)
    for path, value in changes:
        section = config
        *parents, last = path.split(".")
        for key in parents:
            section = section.setdefault(key, {})
        section[last] = value
    complete(config)


def protocol(**settings):
    name = "fbp_180" if settings.get("algorithm") == "fbp" else "sirt_180"
    configured((f"protocols.{name}", {"algorithm": "sirt", "projections": 180} | settings))


def phantom(image="ct.nii.gz", roi=None, oversampling=1):
    roi = {"label": 1} if roi is None else roi
    rois = [{"name": "lesion", "tissue_class": "tumour", **roi}]
    settings = ct.read_settings({"image": image, "labels": "labels.nii.gz", "rois": rois})
    return ct.load_phantom(settings, GRID, oversampling)


def written(array, name, affine=phantom_files.CT_GRID.affine):
    nibabel.save(nibabel.Nifti1Image(array.T, affine), name)
    return name


def with_nan():
    array = phantom_files.object_hu()
    array[:3] = np.nan
    phantom(written(array, "ct.nii.gz"))


def clipped_to_a_window():
    noise = np.random.default_rng(0).normal(0, 10, phantom_files.CT_GRID.shape)
    phantom(written(np.clip(np.rint(phantom_files.object_hu() + noise), -160, 240), "ct.nii.gz"))


def series(second_kernel=None, **attributes):
    """CT as DICOM slices in the folder `series`, with a second series if it has a kernel."""
    slices = phantom_files.ct_slices()
    for one in slices:
        one.ConvolutionKernel = "Br38f"
        for name, value in attributes.items():
            setattr(one, name, value)
    phantom_files.write_series(slices, Path("series"))
    for number, one in enumerate(phantom_files.ct_slices() if second_kernel else ()):
        one.ConvolutionKernel, one.SeriesNumber = second_kernel, 2
        one.save_as(f"series/sharp{number + 1:03d}.dcm", enforce_file_format=True)
    return phantom("series")


def on_another_grid():
    coarse = phantom_files.ball("bright")[::2].astype(np.uint8)
    phantom(roi={"file": written(coarse, "mask.nii.gz", np.diag([2.0, 2, 6, 1]))})


def too_wide():
    geometry = circular(
        views=8,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=40,
        rows=20,
        column_pitch_mm=2.0,
        row_pitch_mm=4.0,
    )
    clean_line_integrals(Volume(phantom_files.object_hu(), GRID), geometry, MU_WATER_PER_MM)


def bench(**changes):
    recording_folders.projections_folder(Path("bench"), **changes)
    load_recording("bench")


def slower():
    folder, content = recording_folders.projections_folder(Path("bench"))
    recording_folders.write_yaml(folder, recording_folders.changed(content, "scan.view_interval_ms", 25))
    load_recording(folder)


def cut_short():
    folder, _ = recording_folders.projections_folder(Path("bench"))
    whole = (folder / "a.h5").read_bytes()
    (folder / "a.h5").write_bytes(whole[: len(whole) // 2])
    load_recording(folder)


def without_flat():
    np.save("ct.npy", np.ones((24, 4, 40)))
    import_projections("ct.npy", "ct")


def without_white():
    folder, _ = recording_folders.projections_folder(Path("bench"))
    with h5py.File(folder / "a.h5", "a") as file:
        del file["exchange/data_white"]
    load_recording(folder)


def clinic(rois=True, **changes):
    """A table with pyradiomics' columns."""
    rows = {"Image": ["a.nii.gz", "b.nii.gz"], "Mask": "m.nii.gz", "Label": 1, FEATURES[0]: [1.0, 2.0]}
    content = {"name": "clinic", "kind": "features", "repeats": ["features.csv"]}
    named = {"rois": [{"name": "liver", "tissue_class": "liver", "label": 1}]} if rois else {}
    recording_folders.write_yaml(Path("clinic"), content | named)
    pd.DataFrame(rows | changes).to_csv("clinic/features.csv", index=False)
    load_recording("clinic")


def wrong_parameters():
    Path("my_params.yaml").write_text("setting: {binwidth: 10}")
    read_parameters("my_params.yaml")


def of_two_versions():
    row = dict.fromkeys(tables.METADATA, "1") | {"protocol": "sirt_150", "noise": "dose10", "roi": "cyst_1"}
    tables.merge_tables(
        pd.DataFrame([row | {"seed": seed, "settings_hash": text}]) for seed, text in enumerate(("5f3a", "9c01"))
    )


def study_of_the_ct(keep_mm=None, **changes):
    """Start a study of the CT, whose balls are `lesion` and `fat`."""
    rois = [{"name": name, "tissue_class": name, "label": label} for label, name in enumerate(("lesion", "fat"), 1)]
    config = copy.deepcopy(DEFAULT) | {
        "phantom": {"source": "ct", "ct": {"image": "ct.nii.gz", "labels": "labels.nii.gz", "rois": rois}},
        "grid": {"shape": [14, 34, 42], "spacing_mm": [3.0, 2.0, 2.0]},
        "measured": {"overlay": False},
        "scan": DEFAULT["scan"] | {"columns": 100, "column_pitch_mm": 2.4},
    }
    if keep_mm:
        config["phantom"]["ct"]["keep_mm"] = keep_mm
    for section, values in changes.items():
        config[section] = config[section] | values
    if lines := problems(config):
        raise InputErrors(lines)


def twice():
    Path("my.yaml").write_text("seed: 1\nseed: 2\n")
    lines, _ = read_configs(["my.yaml"])
    raise InputErrors(lines)


def object_that_is_not_there():
    recording_folders.projections_folder(Path("bench"))
    diagnosed = {"recordings": {"bench": {"object": {"kind": "catphan504_ctp440"}}}}
    raise InputErrors(problems({**DEFAULT, "recordings": {"bench": "bench"}, "diagnosis": diagnosed}))


def rods():
    array = np.zeros(GRID.shape, np.float32)
    for label in (1, 2, 5):
        array[label : label + 2, 10:20, 10:20] = label
    return array


def label_map(array, materials):
    """A recording whose object is a label map."""
    recording_folders.projections_folder(Path("bench"))
    object_ = {"labels": written(array, "rods.nii.gz"), "materials": materials}
    diagnosed = {"recordings": {"bench": {"object": object_}}}
    raise InputErrors(problems({**DEFAULT, "recordings": {"bench": "bench"}, "diagnosis": diagnosed}))


def physics_without_effects():
    Path("bench").mkdir()
    Path("bench/physics.yaml").write_text("# bench and the simulation agree.\n{}\n")
    read_diagnosed_physics("bench/physics.yaml")


TANDEM = {"collection": "ct_phantom4radiomics"}
MULTICENTRIC = {"collection": "ct4harmonization_multicentric"}


def public(selections):
    lines = problems({**DEFAULT, "public_scans": selections})
    raise InputErrors(lines)


def fetched(path):
    """Fetch a scan from an address without a service, with programs of these folders only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fetch.sys, "executable", "/nowhere/python")
        patch.setenv("PATH", path)
        patch.setenv("SERVICE", "elsewhere")
        (scan,) = select_scans(TANDEM | {"groups": [8], "acquisitions": [1]}, "public_scans.phantom")
        fetch.fetch_scan(scan, "resources/printed_phantom/801", "http://localhost:9", "idc-open-data")


def without_s5cmd():
    fetched("/nowhere")


def broken_off():
    Path("bin").mkdir()
    script = Path("bin/s5cmd")
    script.write_text(f"#!{sys.executable}\n" + (ROOT / "tests/recordings/s5cmd_stand_in.py").read_text())
    script.chmod(0o755)
    fetched(str(Path("bin").resolve()))


def empty_folder():
    Path("mine").mkdir()
    find_scans("mine", select_scans(TANDEM | {"groups": [8], "acquisitions": [1]}, "public_scans.phantom"))


# Each mistake, and the file or key that the message must name.
MISTAKES = {
    "A misspelled key": (lambda: protocol(projection=180), "'projection'"),
    "A misspelled algorithm": (lambda: protocol(algorithm="sitr"), "protocols.sirt_180.algorithm"),
    "A number that is text to YAML": (
        lambda: configured(("noise.levels.dose10", {"A": "1e-6", "repeats": 10})),
        "noise.levels.dose10.A",
    ),
    "A scanner's voxels in an iterative protocol": (lambda: protocol(voxels=VOXELS), "protocols.sirt_180.voxels"),
    "Images in boxes where whole ones are needed": (
        lambda: configured(("protocols.fbp_450.voxels", VOXELS)),
        "analyses.optimal.fbp names 'fbp_450'",
    ),
    "A kernel whose two points are the wrong way round": (
        lambda: protocol(algorithm="fbp", kernel={"mtf50_per_cm": 5.0, "mtf10_per_cm": 3.0}),
        "mtf50_per_cm is 5",
    ),
    "Re-positioned repeats that do not move": (
        lambda: configured(("repeats", {"repositioned": 3})),
        "repeats.repositioned moves nothing",
    ),
    "Too few repeats in one place": (
        lambda: configured(
            ("repeats", {"repositioned": 4, "shift_mm": 2, "turn_deg": 0.3}), ("noise.levels.half.repeats", 6)
        ),
        "analyses.noise_calibration compares voxels",
    ),
    "One group number twice": (lambda: protocol(group=2), "protocols.sirt_200 and protocols.sirt_180"),
    "A name that is not there": (lambda: configured(("analyses.optimal.sirt", "sirt_45")), "analyses.optimal.sirt"),
    "No noise at all": (
        lambda: configured(("noise.levels.dose10", {"A": 0, "repeats": 10})),
        "noise.levels.dose10.A",
    ),
    "An effect that does not exist": (
        lambda: configured(("noise.model", "physical"), ("physics", {"scater": {"amount": 0.05}})),
        "physics",
    ),
    "Effects without photons": (lambda: configured(("physics", {"scatter": {}})), "protocols.sirt_150.physics"),
    "A study on a scanner of which nothing was found": (physics_without_effects, "bench and the simulation agree"),
    "A recording that is not configured": (
        lambda: configured(("recordings", {"bench": "recordings/bench"}), ("diagnosis.recordings", {"benhc": {}})),
        "diagnosis.recordings",
    ),
    "An object that is not there": (object_that_is_not_there, "diagnosis.recordings.bench.object"),
    "A label without a material": (
        lambda: label_map(rods(), {1: "pmma", 2: "aluminium"}),
        "diagnosis.recordings.bench.object: rods.nii.gz",
    ),
    "A material that does not exist": (
        lambda: label_map(rods(), {1: "pmma", 2: "alumnium", 5: "pmma"}),
        "materials.2",
    ),
    "A label map that is none": (lambda: label_map(rods() / 4, {1: "pmma"}), "rods.nii.gz"),
    "No ROI": (
        lambda: configured(("phantom", {"source": "ct", "ct": {"image": "ct.nii.gz", "rois": []}})),
        "phantom.ct.rois",
    ),
    "A file that is not there": (lambda: phantom("ct/patient.nii.gz"), "ct/patient.nii.gz"),
    "A CT that is not in HU": (
        lambda: phantom(written(MU_WATER_PER_MM * (1 + phantom_files.object_hu() / 1000), "ct.nii.gz")),
        "ct.nii.gz",
    ),
    "A CT that was clipped to a display window": (clipped_to_a_window, "ct.nii.gz"),
    "A CT whose voxel size was lost": (
        lambda: phantom(written(phantom_files.object_hu(), "ct.nii.gz", np.eye(4))),
        "ct.nii.gz",
    ),
    "A box that cuts the body": (lambda: study_of_the_ct(keep_mm=[[-55, 35], [-80, 0]]), "phantom.ct.keep_mm"),
    "Several series in one folder": (lambda: series("Br59d"), "series"),
    "A DICOM image that is not in HU": (lambda: series(RescaleType="MGML"), "series"),
    "NaN in the CT": (with_nan, "ct.nii.gz"),
    "A mask on another grid": (on_another_grid, "mask.nii.gz"),
    "A label that is not in the map": (lambda: phantom(roi={"label": 7}), "labels.nii.gz"),
    "An empty mask": (
        lambda: phantom(roi={"file": written(np.zeros(GRID.shape, np.uint8), "mask.nii.gz")}),
        "mask.nii.gz",
    ),
    "A key that is there twice": (twice, "seed"),
    "Axes in another order": (
        lambda: study_of_the_ct(grid={"shape": [42, 34, 14], "spacing_mm": [2.0, 2.0, 3.0]}),
        "grid.shape",
    ),
    "A detector that is too small": (lambda: study_of_the_ct(scan={"columns": 60}), "scan.columns"),
    "A body wider than the field of view": (too_wide, "scan"),
    "A folder that is no recording": (lambda: load_recording("bench"), "bench/recording.yaml"),
    "Another number of views": (lambda: bench(data=np.ones((23, 4, 40))), "bench/b.h5"),
    "A parameter file that pyradiomics does not take": (wrong_parameters, "my_params.yaml"),
    "A row that is shifted": (
        lambda: clinic(original_firstorder_Minimum=[0.5, 62]),
        "clinic/features.csv",
    ),
    "A comma with two meanings": (lambda: clinic(**{FEATURES[0]: ["7,678", "8,123"]}), "clinic/features.csv"),
    "A table of pyradiomics without ROIs": (lambda: clinic(rois=False), "clinic/features.csv"),
    "A case that pyradiomics could not extract": (
        lambda: clinic(**{FEATURES[0]: [1.0, np.nan]}),
        "clinic/features.csv",
    ),
    "Repeats of different settings": (
        lambda: clinic(diagnostics_Configuration_Settings=["{'binWidth': 25}", "{'binWidth': 10}"]),
        "clinic/features.csv",
    ),
    "Times that contradict each other": (slower, "bench/recording.yaml"),
    "An array of another shape": (lambda: bench(data=np.ones((24, 40))), "bench/b.h5"),
    "An array of counts without a flat field": (without_flat, "ct.npy"),
    "Counts without their white field": (without_white, "bench/a.h5"),
    "A file that was cut short": (cut_short, "bench/a.h5"),
    "No program to fetch with": (without_s5cmd, "s5cmd"),
    "A fetch that broke off": (broken_off, "resources/printed_phantom/801"),
    "A folder that lacks some of the scans": (empty_folder, "downloads.scans: mine"),
    "A group that the collection has not": (
        lambda: public({"compared": TANDEM | {"groups": [9]}}),
        "public_scans.compared.groups",
    ),
    "A scan compared with itself": (
        lambda: public(
            {"phantom": TANDEM | {"groups": [8], "acquisitions": [1, 2]}, "compared": TANDEM | {"acquisitions": [2, 3]}}
        ),
        "public_scans.phantom and public_scans.compared",
    ),
    "Scans that are not kept, fetched beforehand": (
        lambda: PublicScans(Plan(read_study(DEFAULT | {"keep_scans": False}))).fetched(),
        "config: keep_scans",
    ),
    "A phantom of scans whose slices are not known": (
        lambda: public({"phantom": MULTICENTRIC | {"groups": ["A1"], "dose_mgy": [10]}}),
        "A1_10mGy_FBP_01",
    ),
    "Results of two versions": (of_two_versions, "sirt_150/dose10/seed01.csv"),
}


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A working folder with a CT and a label map."""
    monkeypatch.chdir(tmp_path)
    written(phantom_files.object_hu(), "ct.nii.gz")
    written((phantom_files.ball("bright") + 2 * phantom_files.ball("dark")).astype(np.uint8), "labels.nii.gz")


def matches(message, expected):
    """Return whether a message is as expected; `...` matches any text."""
    return re.fullmatch(".*".join(map(re.escape, expected.split("..."))), message) is not None


def test_every_message_has_a_test():
    assert len(MISTAKES) >= 55
    assert set(MESSAGES) == {*MISTAKES, "A target after the configuration"}


def test_page_quotes_these_messages():
    assert len(EXPLAINED) >= 8 and PAGE.count("<!-- message -->") == len(EXPLAINED)
    for title, quoted in EXPLAINED.items():
        assert matches(MESSAGES[title], quoted), title


def test_correct_input_gives_no_message(desk):
    configured()
    protocol(group=9)
    assert len(phantom().rois) == 1
    study_of_the_ct()
    bench()


@pytest.mark.parametrize("title", MISTAKES)
def test_mistake_gives_its_message(title, desk):
    make, named = MISTAKES[title]
    with pytest.raises(InputError) as error:
        make()
    message = str(error.value)
    assert matches(message, MESSAGES[title].removeprefix("Error: ")), message
    what, _, fix = message.partition("; ")
    assert named in message and what and fix


def test_snakemake_reads_a_target_after_the_configuration_as_a_file():
    command = [warm.python(), "-m", "snakemake", "-n", "--configfile", "config/tiny.yaml", "figure_rois"]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert process.returncode != 0
    assert MESSAGES["A target after the configuration"] in process.stdout + process.stderr
