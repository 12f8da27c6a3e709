"""`virtual-phantom init`: its proposal for a CT with a known object."""

import re
import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import phantom_files
import pytest
import warm
import yaml
from PIL import Image

from virtual_phantom.base.geometry import Grid
from virtual_phantom.cli import main
from virtual_phantom.cli.init.command import preview
from virtual_phantom.cli.init.configuration_file import duration_text
from virtual_phantom.cli.init.propose import propose, sizes
from virtual_phantom.cli.init.regions import tissue_class
from virtual_phantom.config import read_config
from virtual_phantom.config.config import complete
from virtual_phantom.phantom import ct
from virtual_phantom.study.checks import preflight

ROOT = Path(__file__).resolve().parents[2]
CENTRE = phantom_files.CENTRE
REAL = ROOT / "../shared/real/abdomen_ct"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the default configuration, a CT and its regions in every form."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "config").mkdir()
    for name in ("config.yaml", "paper_groups.yaml"):
        shutil.copy(ROOT / "config" / name, folder / "config")
    slices = phantom_files.ct_slices()
    phantom_files.write_series(slices, folder / "dicom")
    phantom_files.write_nifti_array(phantom_files.object_hu(), folder / "ct.nii.gz")
    phantom_files.write_nifti_array(labelled(), folder / "labels.nii.gz", flip_y=True)
    phantom_files.write_seg(slices, folder / "seg.dcm")
    phantom_files.write_rtstruct(folder / "rtstruct.dcm")
    (folder / "masks").mkdir()
    for name in phantom_files.BALLS:
        phantom_files.write_nifti_array(phantom_files.ball(name).astype(np.uint8), folder / "masks" / f"{name}.nii.gz")
    return folder


@pytest.fixture
def desk(files, tmp_path, monkeypatch):
    """A working folder with a copy of these files."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def labelled():
    """3: bright, 5: dark, 9: four voxels."""
    labels = 3 * phantom_files.ball("bright") + 5 * phantom_files.ball("dark")
    labels[7, 20:22, 20:22] = 9
    return labels.astype(np.uint8)


def initialised(*words):
    """The configuration that the command writes, as Snakemake reads it."""
    assert main.main(["init", *words]) == 0
    lines, settings = read_config.read_configs(["my.yaml"])
    assert not lines
    return settings


@pytest.mark.parametrize("image", ["dicom", "ct.nii.gz"])
@pytest.mark.parametrize("labels", ["labels.nii.gz", "seg.dcm", "rtstruct.dcm", "masks"])
def test_regions_of_every_form_become_rois(image, labels, desk, capsys):
    names = ["--names", "3=bright,5=dark"] if labels == "labels.nii.gz" else []
    settings = initialised(image, "--labels", labels, "--size", "quick", *names)
    printed = capsys.readouterr().out
    assert preflight.problems(settings) == []
    phantom = ct.load_phantom(
        ct.read_settings(settings["phantom"]["ct"]), Grid(settings["grid"]["shape"], settings["grid"]["spacing_mm"]), 1
    )
    assert {roi.name for roi in phantom.rois} == {"bright", "dark"}
    for roi in phantom.rois:
        offset, radius, value = phantom_files.BALLS[roi.name]
        assert np.median(phantom.image.array[roi.mask]) == pytest.approx(value, abs=1)
        z, y, x = (axis[index] for axis, index in zip(phantom.image.grid.axes_mm(), np.nonzero(roi.mask), strict=True))
        world = np.array([x.mean(), y.mean(), z.mean()]) + phantom.image.grid.centre_mm
        np.testing.assert_allclose(world, np.add(CENTRE, offset), atol=1)
        ml, hu = map(float, re.search(rf"{roi.name} +\d+ +([\d.]+) +(-?\d+) ", printed).groups())
        assert ml == pytest.approx(4 / 3 * np.pi * radius**3 / 1000, rel=0.1) and hu == pytest.approx(value, abs=1)
    assert Image.open("my.png").size[0] > 300


def test_scanned_volume_is_the_body(desk):
    """A cylinder of 80 x 64 mm (x, y) and 42 mm along z, at `CENTRE`, without a table or arms."""
    settings = initialised("ct.nii.gz", "--labels", "labels.nii.gz")
    phantom = settings["phantom"]["ct"]
    assert "keep_mm" not in phantom and "keep_mm is not needed" in Path("my.yaml").read_text()
    np.testing.assert_allclose(phantom["centre_mm"], CENTRE, atol=1.5)
    (x_low, x_high), (y_low, y_high) = propose("ct.nii.gz", "labels.nii.gz").box_mm
    assert CENTRE[0] - 50 < x_low <= CENTRE[0] - 40 and CENTRE[0] + 40 <= x_high < CENTRE[0] + 50
    assert CENTRE[1] - 42 < y_low <= CENTRE[1] - 32 and CENTRE[1] + 32 <= y_high < CENTRE[1] + 42
    assert settings["grid"]["spacing_mm"] == [3.0, 2.0, 2.0]  # not finer than the CT
    assert settings["measured"] == {"overlay": False}


def test_arms_and_table_are_excluded(desk):
    hu = phantom_files.object_hu()
    hu[:, 0] = 200
    hu[:, 14:26, :3] = 50
    phantom_files.write_nifti_array(hu, "arms.nii.gz")
    plain = propose("ct.nii.gz", "labels.nii.gz").box_mm
    keep_mm = propose("arms.nii.gz", "labels.nii.gz").config["phantom"]["ct"]["keep_mm"]
    np.testing.assert_allclose(keep_mm, plain, atol=0)


def test_whole_chest_is_scanned(desk):
    """An ellipse of 84 x 64 mm with lungs that end 4 mm below its surface, and an arm."""
    z, y, x = np.ix_(*phantom_files.CT_GRID.axes_mm())
    body, arm = (x / 38) ** 2 + (y / 32) ** 2 + 0 * z < 1, (abs(x - 44) < 3) & (abs(y) < 10) & (abs(z) < 99)
    lungs = ((abs(x) - 20) / 15) ** 2 + (y / 24) ** 2 + 0 * z < 1
    hu = np.where(body | arm, 30.0, -1000.0)
    hu[lungs] = -850
    nodule = (x + 20) ** 2 + y**2 + z**2 < 9**2
    hu[nodule] = 40
    labels = np.where(nodule, 2, np.where(lungs & (x > 0), 1, 0)).astype(np.uint8)
    phantom_files.write_nifti_array(hu, "chest.nii.gz")
    phantom_files.write_nifti_array(labels, "chest_labels.nii.gz")
    found = propose("chest.nii.gz", "chest_labels.nii.gz", names={"1": "lung", "2": "nodule"})
    assert [one.region.name for one in found.selected] == ["lung", "nodule"]
    (x_low, x_high), (y_low, y_high) = found.config["phantom"]["ct"]["keep_mm"]
    assert CENTRE[0] - 46 < x_low <= CENTRE[0] - 38 and CENTRE[0] + 38 <= x_high <= CENTRE[0] + 42
    assert CENTRE[1] - 40 < y_low <= CENTRE[1] - 32 and CENTRE[1] + 32 <= y_high < CENTRE[1] + 40


def test_check_of_the_ct_can_be_disabled(desk, capsys):
    """The CT is that of an animal: a quarter of the size."""
    small = Grid(phantom_files.CT_GRID.shape, (0.75, 0.5, 0.5), CENTRE)
    phantom_files.write_nifti_array(phantom_files.object_hu(), "ct.nii.gz", grid=small)
    phantom_files.write_nifti_array(labelled(), "labels.nii.gz", grid=small)
    words = ["init", "ct.nii.gz", "--labels", "labels.nii.gz", "--size", "quick"]
    assert main.main(words) == 1 and "not_checked: [size])" in capsys.readouterr().err
    settings = initialised(*words[1:], "--not-checked", "size")
    assert settings["phantom"]["ct"]["not_checked"] == ["size"] and "--not-checked size" in settings["trial"]
    assert preflight.problems(settings) == []
    assert main.main([*words, "--not-checked", "sise", "--force"]) == 1
    assert "there is no check 'sise'; did you mean 'size'?" in capsys.readouterr().err


def test_ct_without_air_is_noted(desk, capsys):
    hu, labels = (array[:, 10:-10, 12:-12] for array in (phantom_files.object_hu(), labelled()))
    grid = Grid(hu.shape, phantom_files.CT_GRID.spacing, CENTRE)
    phantom_files.write_nifti_array(hu, "ct.nii.gz", grid=grid)
    phantom_files.write_nifti_array(labels, "labels.nii.gz", grid=grid)
    settings = initialised("ct.nii.gz", "--labels", "labels.nii.gz")
    note = "Note: ct.nii.gz: shows no air (-1000 HU), so it is treated as cropped within the body"
    assert note in capsys.readouterr().err and "keep_mm" not in settings["phantom"]["ct"]


def test_too_small_region_is_excluded_and_reported(desk):
    initialised("ct.nii.gz", "--labels", "labels.nii.gz")
    text = Path("my.yaml").read_text()
    assert "# label_9: is too small: about 4 voxels of this grid, at least 128 are needed" in text
    assert [roi["name"] for roi in yaml.safe_load(text)["phantom"]["ct"]["rois"]] == ["label_3", "label_5"]


def test_gas_with_tissue_is_no_region(desk):
    hu = phantom_files.object_hu()
    hu[:5][phantom_files.ball("dark")[:5]] = -900
    phantom_files.write_nifti_array(hu, "gas.nii.gz")
    assert [roi.region.name for roi in propose("gas.nii.gz", "labels.nii.gz").selected] == ["label_3"]


def test_region_in_another_piece_is_excluded_unless_requested(desk):
    hu, labels = phantom_files.object_hu(), labelled()
    hu[:, 16:24, :3], labels[:, 17:23, :3] = 50, 7  # the body begins one column farther
    phantom_files.write_nifti_array(hu, "arm.nii.gz")
    phantom_files.write_nifti_array(labels, "arm_labels.nii.gz")
    found = propose("arm.nii.gz", "arm_labels.nii.gz")
    assert ["trunk" in reason for region, reason in found.rejected if region.name == "label_7"] == [True]
    defaults = propose("arm.nii.gz", "arm_labels.nii.gz", rois=["3", "label_7"])
    assert [one.region.label for one in defaults.selected] == [3, 7]
    assert defaults.box_mm[0][0] < found.box_mm[0][0] == found.config["phantom"]["ct"]["keep_mm"][0][0]


def test_file_states_the_proposal_and_its_cost(desk):
    settings = initialised("ct.nii.gz", "--labels", "labels.nii.gz", "--size", "quick")
    again = "virtual-phantom init ct.nii.gz --labels labels.nii.gz --size normal --out my-normal.yaml"
    proposed = propose("ct.nii.gz", "labels.nii.gz", size="quick", results_dir="results-my", instead=again)
    text = Path("my.yaml").read_text()
    assert yaml.safe_load(text) == proposed.config
    assert f"{proposed.cost['acquisitions']} scans in {proposed.cost['jobs']} jobs" in text
    assert all(len(line) < 130 or "name:" in line for line in text.splitlines())
    whole = complete(settings)
    # It has no section of the default study that a quick one lacks.
    assert set(whole["protocols"]) == set(sizes()["quick"]["protocols"])
    assert set(whole["noise"]["levels"]) == set(sizes()["quick"]["levels"])
    assert whole["analyses"]["pca"]["sirt"]["noise"] == ["dose10", "double"]


def test_quick_study_is_a_trial_and_names_the_command_for_results(desk, capsys):
    words = ["ct.nii.gz", "--labels", "labels.nii.gz", "--names", "3=a,5=b", "--rois", "a,b"]
    settings = initialised(*words, "--size", "quick")
    assert f"Then, for real results: {settings['trial']}" in capsys.readouterr().out
    begin, *rest = shlex.split(settings["trial"])
    assert begin == "virtual-phantom" and rest[-1] == "my-normal.yaml" and main.main(rest) == 0
    lines, normal = read_config.read_configs(["my-normal.yaml"])
    assert not lines and "trial" not in normal
    assert [roi["name"] for roi in normal["phantom"]["ct"]["rois"]] == ["a", "b"]


def test_region_of_several_tissues_is_reported(desk, capsys):
    """A tenth of the ball is as dense as bone; the rest has one value."""
    hu, ball = phantom_files.object_hu(), phantom_files.ball("dark")
    hu[tuple(axis[::10] for axis in np.nonzero(ball))] = 900
    phantom_files.write_nifti_array(hu, "calcium.nii.gz")
    sd = hu[ball].std()
    initialised("calcium.nii.gz", "--labels", "labels.nii.gz")
    doubt = f"SD {sd:.0f}: calcium, bone or air inside?"
    assert f"label_5: {doubt}\n" in capsys.readouterr().out and f"HU ({doubt});" in Path("my.yaml").read_text()
    assert Path("my.yaml").read_text().count("calcium, bone") == 1


def test_legend_of_the_picture_names_what_it_shows(desk):
    """A thin region is outlined although it is not used, unless the picture ends before it."""

    def legend(labels, box_mm=None):
        phantom_files.write_nifti_array(labels, "some.nii.gz", flip_y=True)
        proposed = propose("ct.nii.gz", "some.nii.gz")
        proposed = replace(proposed, box_mm=box_mm or proposed.box_mm)
        return [text.get_text() for text in preview(proposed).legends[0].get_texts()]

    some, shown = labelled(), ["label 3", "label 5", "scanned box"]
    some[some == 9] = 0
    assert legend(some) == shown
    some[:, :2, :2] = 9
    assert legend(some) == [*shown[:2], "not used", shown[2]]
    assert legend(some, [[x - 20, x + 20] for x in CENTRE[:2]]) == shown


def test_size_normal_is_the_study_of_the_papers_groups():
    default, normal = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text()), sizes()["normal"]
    assert normal["protocols"] == default["protocols"] and normal["levels"] == default["noise"]["levels"]
    assert normal["analyses"] == default["analyses"]
    assert normal["grid"] == default["grid"] and normal["scan"] == default["scan"]
    sirt = complete(default)["reconstruction"]["sirt"]
    assert normal["reconstruction"]["sirt"].items() <= sirt.items()


def test_existing_files_are_kept(desk, capsys):
    words = ["init", "ct.nii.gz", "--labels", "labels.nii.gz"]
    Path("my.yaml").write_text("mine")
    assert main.main(words) == 1 and Path("my.yaml").read_text() == "mine"
    assert "my.yaml: already exists; give another --out, or --force" in capsys.readouterr().err
    assert main.main([*words, "--force"]) == 0 and Path("my.yaml").read_text() != "mine"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing.nii.gz", "--labels", "labels.nii.gz"], "nothing.nii.gz: no such file"),
        (["ct.nii.gz", "--labels", "nothing.nii.gz"], "nothing.nii.gz: no such file"),
        (["ct.nii.gz", "--labels", "config"], "config: has no mask (NIfTI, NRRD, MetaImage)"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--names", "4=liver"], "has no region '4'; there are: 3, 5, 9"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--names", "liver"], "'liver' is not LABEL=NAME"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--names", "3=a/b"], "'a/b' must be of letters"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--names", "3=a,5=a"], "two regions have the name a"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--rois", "3,liver"], "has no region 'liver'"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--rois", "3,9"], "--rois: label_9 is too small"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--out", "my.txt"], "my.txt must end in .yaml"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--out", "f.yaml", "--force"], "f.yaml: is a folder; give another"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--out", "/proc/my.yaml"], "/proc/my.png: cannot be written"),
        (["ct.nii.gz", "--labels", "labels.nii.gz", "--out", "ct.nii.gz/my.yaml"], "my.png: cannot be written"),
        (["dicom/001.dcm", "--labels", "labels.nii.gz"], "is one DICOM file; give the folder of its series"),
        (["", "--labels", "labels.nii.gz"], "image: is empty; give a path"),
        (["ct.nii.gz", "--labels", ""], "--labels: is empty; give a path"),
        ([".", "--labels", "labels.nii.gz"], "ct.nii.gz: an image, not DICOM; to read it, give its own path"),
        (["zero.nii", "--labels", "labels.nii.gz"], "zero.nii: has the same value everywhere (0)"),
        (["lone.mhd", "--labels", "labels.nii.gz"], "lone.mhd: cannot be read as MHD"),
        (["ct.zip", "--labels", "labels.nii.gz"], "ct.zip: is an archive; unpack it to use what is in it"),
        (["labels.nii.gz", "--labels", "ct.nii.gz"], "has 4 different whole numbers up to 9, as a label map or mask"),
    ],
)
def test_errors_are_one_line_and_nothing_is_written(words, message, desk, capsys):
    Path("f.yaml").mkdir()
    Path("ct.zip").write_bytes(b"PK" + bytes(200))
    phantom_files.write_nifti_array(np.zeros(phantom_files.CT_GRID.shape, np.float32), "zero.nii")
    Path("lone.mhd").write_text("NDims = 3\nDimSize = 9 9 9\nElementType = MET_SHORT\nElementDataFile = lone.raw\n")
    before = sorted(Path().rglob("*"))
    assert main.main(["init", *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("Error: ") and message in line
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize(
    ("name", "expected"),
    [("muscle_left", "muscle"), ("liver", "liver"), ("vertebrae_l1", "vertebrae"), ("label_5", "label_5"), ("1", "1")],
)
def test_regions_of_one_tissue_are_of_one_class(name, expected):
    assert tissue_class(name) == expected


def test_snakemake_accepts_the_written_file(desk):
    """From the command to the phantom and its figure, and a plan of all other jobs."""
    initialised("dicom", "--labels", "seg.dcm", "--size", "quick")
    run = [warm.python(), "-m", "snakemake", "-s", str(ROOT / "workflow" / "Snakefile"), "--cores", "2", "--nolock"]
    made = subprocess.run([*run, "figure_rois", "--configfile", "my.yaml"], capture_output=True, text=True, timeout=600)
    assert made.returncode == 0, made.stderr[-3000:]
    assert Path("results-my/figures/rois.png").exists()
    planned = subprocess.run([*run, "-n", "--configfile", "my.yaml"], capture_output=True, text=True, timeout=600)
    assert planned.returncode == 0, planned.stderr[-3000:]


@pytest.mark.real
def test_proposal_for_a_clinical_ct_agrees_with_the_manual_one(monkeypatch, tmp_path):
    """Compare with config/abdomen.yaml, which was written by hand for the same CT."""
    if not REAL.exists():
        pytest.skip("needs abdomen_ct among the real measurements")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "abdomen_ct").symlink_to(REAL)
    names = {"5": "liver", "1": "spleen", "87": "muscle_right", "86": "muscle_left", "52": "aorta"}
    found = propose("abdomen_ct/dicom", "abdomen_ct/labels.nii.gz", names=names, rois=list(names)).config
    hand = yaml.safe_load((ROOT / "config" / "abdomen.yaml").read_text())
    proposed_ct, manual = found["phantom"]["ct"], hand["phantom"]["ct"]
    np.testing.assert_allclose(proposed_ct["keep_mm"], manual["keep_mm"], atol=12)
    np.testing.assert_allclose(proposed_ct["centre_mm"], manual["centre_mm"], atol=6)
    assert found["grid"]["shape"][0] == hand["grid"]["shape"][0]
    np.testing.assert_allclose(found["grid"]["spacing_mm"], hand["grid"]["spacing_mm"], rtol=0.05)
    assert found["grid"]["oversampling"] == hand["grid"]["oversampling"]
    width = {name: one["columns"] * one["column_pitch_mm"] for name, one in (("o", found["scan"]), ("t", hand["scan"]))}
    assert width["o"] == pytest.approx(width["t"], rel=0.05)
    assert found["scan"]["rows"] == hand["scan"]["rows"]
    parts = {roi["name"]: (roi["tissue_class"], roi.get("parts", 1)) for roi in manual["rois"]}
    assert {roi["name"]: (roi["tissue_class"], roi.get("parts", 1)) for roi in proposed_ct["rois"]} == parts
    default = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
    assert preflight.problems(default | found) == []


@pytest.mark.parametrize(("hours", "words"), [(1 / 30, "50 s to 2.5 min"), (1.0, "25 min to 1 h")])
def test_time_is_a_range_of_a_factor_of_one_and_a_half_in_either_direction(hours, words):
    """With two cores, 84 and 2346 s: 6 s to start, and 1.3 times the core hours."""
    assert duration_text(hours) == words
