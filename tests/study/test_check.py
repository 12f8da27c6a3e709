"""`virtual-phantom check`: ten configurations with three mistakes each, all of which one run names."""

import copy
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import phantom_files
import pytest
import recording_folders
import warm
import yaml
from snakemake.utils import update_config

from virtual_phantom.base.errors import InputError, InputErrors, printed
from virtual_phantom.base.geometry import Grid, scan_geometry
from virtual_phantom.base.settings import ScanSettings, from_mapping
from virtual_phantom.cli import main
from virtual_phantom.config import read_config
from virtual_phantom.config.config import complete
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.scenes.line_integrals import check_rois_seen
from virtual_phantom.study.checks import preflight, preflight_ct
from virtual_phantom.study.checks.coverage import columns_for, points_of, rows_for, worst_share

ROOT = Path(__file__).resolve().parents[2]
DEFAULT, PAPER_GROUPS = (ROOT / "config" / f"{name}.yaml" for name in ("config", "paper_groups"))
BASE = {"base": "config/paper_groups.yaml"}
SCAN = {"columns": 100, "column_pitch_mm": 2.4, "rows": 30, "row_pitch_mm": 4.0}
SCAN |= {"source_to_isocentre_mm": 500, "source_to_detector_mm": 1000}
# The CT of phantom_files: 48 x 40 x 14 voxels (x, y, z) of 2 x 2 x 3 mm, a body of 80 x 64 mm (x, y).
CT = BASE | {
    "grid": {"shape": [14, 34, 42], "spacing_mm": [3.0, 2.0, 2.0]},
    "scan": SCAN,
    "phantom": {
        "source": "ct",
        "ct": {
            "image": "ct.nii.gz",
            "labels": "labels.nii.gz",
            "rois": [
                {"name": "bright", "tissue_class": "tumour", "label": 1},
                {"name": "dark", "tissue_class": "fat", "label": 2},
            ],
        },
    },
    "measured": {"overlay": False},
}


def ct(**changes):
    """Study of the CT with values set at keys, where __ represents a dot."""
    return changed(CT, **changes)


def changed(settings=None, **changes):
    settings = copy.deepcopy(settings or BASE)
    for path, value in changes.items():
        section = settings
        *parents, last = path.split("__")
        for key in parents:
            section = section.setdefault(key, {})
        section[last] = value
    return settings


def with_rois(*rois, **changes):
    return ct(phantom__ct__rois=list(rois), **changes)


def roi(name, label, tissue_class="tumour", **more):
    return {"name": name, "tissue_class": tissue_class, "label": label, **more}


# Configurations as settings or as text, and the required content of each of the three lines.
CASES = {
    "misspelled keys": (
        changed(protocols__sirt_180={"algorithm": "sirt", "projection": 180}, grid__spacing=[2, 2, 2], seeds=3),
        [
            "unknown key 'projection' in protocols.sirt_180; did you mean 'projections'?",
            "unknown key 'spacing' in grid; did you mean 'spacing_mm'?",
            "unknown key 'seeds' in config; did you mean 'seed'?",
        ],
    ),
    "numbers that are none": (
        changed(
            noise__levels__dose10={"A": "1e-6", "repeats": 10},
            scan__pitch=-1,
            protocols__fbp_150={"algorithm": "fbp", "projections": 150.0, "group": 5},
        ),
        [
            "noise.levels.dose10.A: '1e-6' is text to YAML; write 1.0e-6",
            "scan.pitch: -1 is less than or equal to the minimum of 0; give more than 0",
            "protocols.fbp_150.projections: 150.0 is not a whole number to YAML; write 150",
        ],
    ),
    "names that are not there": (
        changed(
            analyses__optimal={"sirt": "sirt_45", "fbp": "fbp_450", "noise": "dose10"},
            analyses__stability__noise="dose1",
            analyses__pca__fbp__protocols=["fbp_150", "sirt_300"],
        ),
        [
            "analyses.optimal.sirt names 'sirt_45', which does not exist; did you mean 'sirt_450'?",
            "analyses.stability.noise names 'dose1', which does not exist; did you mean 'dose10'?",
            "analyses.pca.fbp.protocols names 'sirt_300', whose algorithm is sirt; name a protocol of algorithm fbp",
        ],
    ),
    "protocols of one's own": (
        changed(
            protocols__mine={"algorithm": "sitr", "projections": 90},
            protocols__half_dose={"algorithm": "sirt", "projections": 150, "group": 2},
            physics={"scater": {"amount": 0.05}},
            noise__model="physical",
        ),
        [
            "protocols.mine.algorithm is 'sitr'; use one of sirt, fbp",
            "protocols.sirt_200 and protocols.half_dose have the same group number, 2; give each its own",
            "there is no effect 'scater'; did you mean 'scatter'?",
        ],
    ),
    "files that are not there": (
        ct(
            phantom__ct__image="patient.nii.gz",
            phantom__ct__labels="label.nii.gz",
            recordings={"scanner": "recordings/scanner"},
        ),
        [
            "phantom.ct.image: patient.nii.gz: no such file; give the path of a NIfTI image",
            "label.nii.gz: no such file; give the path of the ROIs",
            "recordings/scanner/recording.yaml: no such file",
        ],
    ),
    "regions that are not there": (
        with_rois(
            roi("bright", 1),
            roi("liver", 7),
            roi("dark", 2, "fat", margin_mm=30),
            {"name": "lesion", "tissue_class": "cyst", "file": "lesion.nii.gz"},
        ),
        [
            "ROI liver: labels.nii.gz: no voxel has the label 7; there are: 1, 2",
            "ROI dark is lost by margin_mm 30; make it smaller",
            "lesion.nii.gz: no such file",
        ],
    ),
    "the order of axes": (
        ct(
            grid={"shape": [42, 34, 14], "spacing_mm": [2.0, 2.0, 3.0]},
            phantom__ct__rois=[roi("bright", 1), roi("dark", 3, "fat")],
            analyses__noise_calibration__noise=["dose10"],
        ),
        [
            "grid.shape [42, 34, 14] looks like x, y, z; write z, y, x: [14, 34, 42]",
            "ROI dark: labels.nii.gz: no voxel has the label 3",
            "analyses.noise_calibration.noise: has 1 entries; give at least 2",
        ],
    ),
    "a detector that is too small": (
        ct(scan__columns=60, scan__rows=8, scan__trajectory="circular", measured__overlay=True),
        [
            "scan: the phantom reaches 40 mm from the isocenter, the field of view only 36 mm: 4 mm are missing; set "
            "scan.columns to at least 67 (now 60), or scan.column_pitch_mm to at least 2.7",
            "scan: ROIs bright, dark are not seen from every direction",
            "measured.overlay needs exactly the ROIs",
        ],
    ),
    "recordings": (
        changed(
            recordings={"bench": "bench", "table": "nowhere"},
            diagnosis__recordings={"benhc": {}, "bench": {"effects": ["scater"]}},
        ),
        [
            "nowhere/recording.yaml: no such file",
            "diagnosis.recordings names 'benhc', which does not exist; did you mean 'bench'?",
            "diagnosis.recordings.bench: diagnosis.effects: there is no effect 'scater'; did you mean 'scatter'?",
        ],
    ),
    "one file, as it was typed": (
        "seed: 1\n"
        "protocols:\n"
        "  sirt_100: {algorithm: sirt, projections: 100}\n"
        "  sirt-75: {algorithm: sirt, projections: 75}\n"
        "  sirt_100: {algorithm: sirt, projections: 110}\n"
        "keep_images: 'no'\n",
        [
            "my.yaml: protocols.sirt_100 occurs twice, in lines 3 and 5; YAML uses the last one",
            "protocols: 'sirt-75' must be of letters, digits and underscores only",
            "keep_images: 'no' is not of type 'boolean'",
        ],
    ),
}


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A working folder with the two studies to change, a CT, its label map and a recording."""
    monkeypatch.chdir(tmp_path)
    Path("config").mkdir()
    for file in (DEFAULT, PAPER_GROUPS):
        (Path("config") / file.name).write_text(file.read_text())
    phantom_files.write_nifti_array(phantom_files.object_hu(), "ct.nii.gz")
    labels = phantom_files.ball("bright") + 2 * phantom_files.ball("dark")
    phantom_files.write_nifti_array(labels.astype(np.uint8), "labels.nii.gz")
    recording_folders.projections_folder(Path("bench"))


def checked(settings, capsys):
    """Exit code and lines of the command for a configuration."""
    text = settings if isinstance(settings, str) else yaml.safe_dump(settings)
    Path("my.yaml").write_text(text)
    code = main.main(["check", "my.yaml"])
    messages = capsys.readouterr()
    return code, (messages.out + messages.err).splitlines()


def lines_and_notes(settings, capsys):
    """Exit code, mistakes and notes of the command for a configuration."""
    code, lines = checked(settings, capsys)
    notes = [line for line in lines if line.startswith("Note: ")]
    others = [line for line in lines if line not in notes and "no errors found" not in line]
    mistakes = [re.sub(r"^(Error: | *\d+\. )", "", line) for line in others]
    return code, [line for line in mistakes if not line.endswith("mistakes")], notes


def test_ten_configurations_have_three_mistakes_each():
    assert len(CASES) == 10 and all(len(lines) == 3 for _, lines in CASES.values())


@pytest.mark.parametrize("title", CASES)
def test_every_mistake_and_nothing_else_is_named_in_one_run(title, desk, capsys):
    settings, expected = CASES[title]
    code, (head, *lines) = checked(settings, capsys)
    assert (code, head) == (1, "Error: 3 mistakes"), lines
    for number, line in enumerate(lines, start=1):
        assert line.startswith(f"{number:>3}. ")
        assert sum(messages in line for messages in expected) == 1, line
    assert all(any(messages in line for line in lines) for messages in expected), lines


def test_correct_configuration_is_confirmed(desk, capsys):
    assert checked(CT, capsys) == (0, ["my.yaml: no errors found"])
    assert checked({}, capsys)[0] == 0


def test_body_cut_by_keep_mm_is_a_mistake(desk, capsys):
    """The part of an ellipse beyond h of its half axis has the share (arccos h - h sqrt(1 - h^2)) / pi.

    The body's half axis is 40 mm along x, and 30 mm of it are kept.
    """
    share = 100 * (np.arccos(0.75) - 0.75 * np.sqrt(1 - 0.75**2)) / np.pi
    settings = ct(phantom__ct__keep_mm=[[-55, 35], [-80, 0]])
    code, lines, _ = lines_and_notes(settings, capsys)
    (line,) = lines
    found = re.fullmatch(
        r"phantom.ct.keep_mm: removes ([\d.]+) % of the body \(voxels above -300 HU in its filled outline\), "
        r"(\d+) mm from the nearest ROI \((\w+)\); widen it to \[\[-35, 45\], \[-72, -8\]\] or delete it "
        r"\(if it is right: not_checked: \[keep_mm\]\)",
        line,
    )
    assert code == 1 and found, line
    assert float(found[1]) == pytest.approx(share, abs=0.5)
    # The ball `bright` ends 14 + 9 mm from the axis; the first column outside is at 31 mm.
    assert found[3] == "bright" and float(found[2]) == pytest.approx(8, abs=2)
    settings["phantom"]["ct"]["not_checked"] = ["keep_mm"]
    code, lines, notes = lines_and_notes(settings, capsys)
    assert code == 0 and notes == [
        f"Note: phantom.ct.keep_mm: removes {found[1]} % of the tissue (voxels above -300 HU): 0 % outside the "
        f"body, such as arms and table, and {found[1]} % of the body, {found[2]} mm from the nearest ROI (bright)"
    ]


def test_table_removed_by_keep_mm_is_a_note_each_time(desk, capsys):
    hu = phantom_files.object_hu()
    hu[:, 0] = 200
    phantom_files.write_nifti_array(hu, "ct.nii.gz")
    body = np.count_nonzero(phantom_files.object_hu() > -300)
    settings = ct(phantom__ct__keep_mm=[[-60, 60], [-76, 0]])
    Path(".snakemake").mkdir()
    for _ in range(2):
        code, lines, notes = lines_and_notes(settings, capsys)
        share = f"{100 * hu[:, 0].size / (hu[:, 0].size + body):.2g}"
        assert code == 0 and not lines and len(notes) == 1
        assert f"removes {share} % of the tissue (voxels above -300 HU): {share} % outside" in notes[0]
        assert notes[0].endswith("and 0 % of the body")
    assert [cached.read_bytes() for cached in Path(".snakemake/virtual_phantom").iterdir()] == [b"notes"]


def test_ct_not_in_hu_hides_no_mistake_of_its_regions(desk, capsys):
    phantom_files.write_nifti_array(phantom_files.object_hu() + 1024, "ct.nii.gz")
    _, lines, _ = lines_and_notes(with_rois(roi("bright", 1), roi("lost", 9, "fat")), capsys)
    assert len(lines) == 2 and "perhaps HU + 1024" in lines[0] and "no voxel has the label 9" in lines[1]


def test_label_map_is_read_and_its_labels_may_be_numbers(desk, capsys):
    def messages(labels, materials):
        object_ = {"labels": labels, "materials": materials}
        diagnosis = {"recordings": {"bench": {"object": object_}}}
        code, lines = checked({"recordings": {"bench": "bench"}, "diagnosis": diagnosis}, capsys)
        where = "Error: diagnosis.recordings.bench.object: "
        return code, [line.removeprefix(where) for line in lines]

    assert messages("labels.nii.gz", {1: "pmma", "2": "aluminium"}) == (0, ["my.yaml: no errors found"])
    code, (line,) = messages("labels.nii.gz", {1: "pmma"})
    assert code == 1 and line.startswith(
        "labels.nii.gz: its label 2 has no material; name one for each under materials"
    )
    code, (line,) = messages("label.nii.gz", {1: "pmma"})
    assert code == 1 and line == "label.nii.gz: no such file; give the path of a NIfTI image"
    code, (line,) = messages("labels.nii.gz", {1: "pmma", 2: "delrin"})
    assert code == 1 and line.startswith("materials.2: material 'delrin' is unknown; known: water, ")
    code, (line,) = messages("labels.nii.gz", {1: "pmma", 2: {"compound": "H2O"}})
    assert code == 1 and "materials.2: 'density_g_per_cm3' is a required property" in line


def test_mask_is_read(desk, capsys):
    def messages(mask):
        diagnosis = {"recordings": {"bench": {"object": {"mask": mask, "material": "pmma"}}}}
        return checked({"recordings": {"bench": "bench"}, "diagnosis": diagnosis}, capsys)

    where = "Error: diagnosis.recordings.bench.object.mask: "
    assert messages("labels.nii.gz") == (
        1,
        [f"{where}labels.nii.gz: holds values outside 0 to 1; give the share of every voxel that the object fills"],
    )
    assert messages("no.nii.gz") == (1, [f"{where}no.nii.gz: no such file; give the path of a NIfTI image"])
    phantom_files.write_nifti_array(phantom_files.ball("bright").astype(np.uint8), "mask.nii.gz")
    assert messages("mask.nii.gz") == (0, ["my.yaml: no errors found"])


def test_one_mistake_is_one_line(desk, capsys):
    assert checked({"sed": 3}, capsys) == (1, ["Error: config: unknown key 'sed' in config; did you mean 'seed'?"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: [1\nscan: 2\n", "my.yaml, line 2: cannot be read as YAML"),
        ("scan:\n\trows: 2\n", "my.yaml, line 2: cannot be read as YAML"),
        ("- 1\n", "my.yaml: is not a mapping of keys to values"),
    ],
)
def test_file_other_than_a_configuration_is_one_line(text, message, desk, capsys):
    code, (line,) = checked(text, capsys)
    assert code == 1 and line.startswith(f"Error: {message}")


@pytest.mark.parametrize(
    ("rois", "chosen", "message"),
    [
        ({"bright": "tumour", "dark": "fat"}, None, None),
        ({"bright": "tumour"}, ["bright"], None),
        ({"bright": "tumour", "spine": "bone"}, ["bright"], None),
        (
            {"bright": "cyst"},
            ["bright"],
            "bright has tissue_class cyst, in the study tumour; if they are the same",
        ),
        ({"spine": "bone"}, None, "none of spine is an ROI of the study, so no ROI can be compared"),
        ({"spine": "bone"}, None, "the name and tissue_class of the study: bright (tumour), dark (fat)"),
        (
            {"bright": "tumour"},
            None,
            "comparison.tumors: the recording has no ROI dark; to compare the common ROIs, add rois: [bright]",
        ),
        (
            {"bright": "tumour", "dark": "fat", "spine": "bone"},
            None,
            "comparison.tumors: the study has no ROI spine; to",
        ),
        ({"bright": "tumour"}, ["dark"], "comparison.tumors: the recording has no ROI dark; to compare"),
    ],
)
def test_regions_of_a_table_are_compared_with_those_of_the_study(rois, chosen, message, desk, capsys):
    _, content = recording_folders.features_folder(Path("clinic"))
    content["rois"] = [{"name": name, "tissue_class": kind, "label": n} for n, (name, kind) in enumerate(rois.items())]
    recording_folders.write_yaml(Path("clinic"), content)
    for first, file in enumerate(content["repeats"]):
        rows = [
            recording_folders.noise_features(10 * label + image, 40)[:1].assign(image=f"i{image}", Label=label)
            for label in range(len(rois))
            for image in range(2 * first, 2 * first + 2)
        ]
        pd.concat(rows).drop(columns="roi").assign(dose_mgy=1).to_csv(f"clinic/{file}", index=False)
    comparison_settings = {"recording": "clinic", "where": {"dose_mgy": 1}, "protocol": "fbp_150", "noise": "dose10"}
    comparison_settings |= {} if chosen is None else {"rois": chosen}
    code, lines = checked(
        changed(CT, recordings={"clinic": "clinic"}, analyses__comparison={"tumors": comparison_settings}), capsys
    )
    assert (code, len(lines)) == (int(message is not None), 1), lines
    assert (message or "no errors") in lines[0]


@pytest.mark.parametrize("key", ["image", "labels"])
@pytest.mark.parametrize(
    ("value", "problem"), [("", "should be non-empty"), (5, "is the number 5 to YAML"), ([], "is not of")]
)
def test_path_that_is_no_text_is_named(key, value, problem, desk, capsys):
    code, lines, _ = lines_and_notes(ct(**{f"phantom__ct__{key}": value}), capsys)
    assert code == 1 and lines[0].startswith(f"config: phantom.ct.{key}: ") and problem in lines[0], lines
    assert not any("unexpected" in line for line in lines)


def test_missing_file_is_one_line(desk, capsys):
    assert main.main(["check", "nothing.yaml"]) == 1
    assert capsys.readouterr().err.startswith("Error: nothing.yaml: no such file; give")


def test_files_are_merged_as_by_snakemake(desk):
    Path("a.yaml").write_text("protocols: {group_1: null, x: {algorithm: sirt, projections: 2}}\nseed: 1\n")
    Path("b.yaml").write_text("seed: 2\nprotocols: {x: {projections: 3}}\n")
    lines, settings = read_config.read_configs(["a.yaml", "b.yaml"])
    expected = yaml.safe_load(DEFAULT.read_text())
    for name in ("a.yaml", "b.yaml"):
        update_config(expected, yaml.safe_load(Path(name).read_text()))
    assert (lines, settings) == ([], expected)


def test_every_mistake_of_a_recording_is_named_in_one_run(desk, capsys):
    document = Path("bench/recording.yaml")
    content = yaml.safe_load(document.read_text())
    document.write_text(yaml.safe_dump(content | {"kind": "sinograms", "origni": {}, "held_out": ["gone.h5"]}))
    code, (head, *lines) = checked(changed(recordings={"bench": "bench"}), capsys)
    assert (code, head, len(lines)) == (1, "Error: 3 mistakes", 3)
    for messages in ("kind is 'sinograms'", "unknown key 'origni'", "'gone.h5' does not exist"):
        assert sum(messages in line for line in lines) == 1, lines


def test_folder_without_a_configuration_uses_the_default_study(desk, capsys):
    for name in ("config", "paper_groups"):
        Path(f"config/{name}.yaml").unlink()
    assert read_config.read_configs([]) == ([], yaml.safe_load(DEFAULT.read_text()))
    assert checked(CT, capsys) == (0, ["my.yaml: no errors found"])
    code, lines = checked(changed(CT, protocols__sirt_150={"projection": 3}), capsys)
    assert code == 1 and "unknown key 'projection' in protocols.sirt_150" in lines[0]
    code, lines = checked({"protocols": {"group_2": {"projection": 3}}}, capsys)
    assert code == 1 and "unknown key 'projection' in protocols.group_2" in lines[0]


def test_base_is_the_study_that_a_configuration_changes(desk):
    """The last `base` counts; `base` may also be in a file that is changed by others."""
    Path("a.yaml").write_text("base: config/paper_groups.yaml\nseed: 1\n")
    Path("b.yaml").write_text("seed: 2\n")
    Path("c.yaml").write_text("base: config/config.yaml\n")
    for files, base in ((["b"], DEFAULT), (["a"], PAPER_GROUPS), (["a", "b"], PAPER_GROUPS), (["a", "c"], DEFAULT)):
        lines, settings = read_config.read_configs([f"{name}.yaml" for name in files])
        assert not lines and settings["protocols"] == yaml.safe_load(base.read_text())["protocols"], files
    assert read_config.read_configs([PAPER_GROUPS]) == ([], yaml.safe_load(PAPER_GROUPS.read_text()))


@pytest.mark.parametrize(
    ("base", "problem"),
    [
        ("config/tiny.yaml", "is 'config/tiny.yaml'; use one of config/config.yaml, config/paper_groups.yaml"),
        ("paper_groups", "is 'paper_groups'; use one of config/config.yaml, config/paper_groups.yaml"),
        (3, "3"),
        ([], "[]"),
    ],
)
def test_unknown_base_is_named(base, problem, desk, capsys):
    code, lines = checked({"base": base}, capsys)
    assert code == 1 and len(lines) == 1 and lines[0].startswith("Error: config: base") and problem in lines[0], lines


@pytest.fixture
def looks(monkeypatch):
    """List of all checks of a CT."""
    made, look = [], preflight_ct.ct_problems
    monkeypatch.setattr(preflight_ct, "ct_problems", lambda study: made.append(study.seed) or look(study))
    return made


def test_correct_ct_is_checked_once(desk, looks):
    _, settings = read_config.read_configs([])
    settings |= CT
    assert [preflight.problems(settings, keep=True) for _ in range(3)] == [[], [], []] and len(looks) == 1
    (cached,) = Path(".snakemake/virtual_phantom").iterdir()
    assert len(cached.name) == 64 and cached.read_bytes() == b""  # no user file
    assert preflight.problems(settings | {"seed": 7}, keep=True) == [] and looks[1:] == [7]


@pytest.mark.parametrize("file", ["ct.nii.gz", "labels.nii.gz"])
def test_changed_file_is_checked_again(desk, looks, file):
    _, settings = read_config.read_configs([])
    settings |= CT
    assert preflight.problems(settings, keep=True) == []
    whole = Path(file).read_bytes()
    Path(file).write_bytes(whole[:-200] + bytes(200))  # of unchanged length
    lines = preflight.problems(settings, keep=True)
    assert len(looks) == 2 and len(lines) == 1 and file in lines[0]
    # Mistakes are reported at every start.
    assert preflight.problems(settings, keep=True) == lines and len(looks) == 3
    Path(file).unlink()
    assert "no such file" in preflight.problems(settings, keep=True)[0]


def test_every_mistake_of_a_scan_in_place_of_an_object_is_named(desk):
    recording_folders.projections_folder(Path("bench"))
    recording_folders.write_yaml(Path("other"), {"name": "other", "kind": "images", "repeats": ["a.nii.gz"], "x": 1})
    _, settings = read_config.read_configs([])
    diagnosed = {"recordings": {"bench": {"object": {"scan": "other"}}}}
    lines = preflight.problems(settings | {"recordings": {"bench": "bench"}, "diagnosis": diagnosed})
    named = [line for line in lines if line.startswith("other/recording.yaml: ")]
    assert len(named) == 2 and "unknown key 'x'" in named[0] and "'a.nii.gz' does not exist" in named[1], lines


def test_filters_need_whole_images(desk):
    _, settings = read_config.read_configs([])
    recording_folders.write_yaml(Path("own"), {"imageType": {"LoG": {"sigma": [3.0]}}, "featureClass": {"glcm": None}})
    parameters = {"parameters": "own/recording.yaml"}
    (line,) = preflight.problems(settings | {"features": settings["features"] | parameters})
    assert line.startswith("features.parameters: filters and normalization (own/recording.yaml) need whole images")
    assert "; remove them, or `voxels` of group_1, group_2, " in line, line


def test_own_simulation_is_read(desk, capsys):
    def found(name):
        diagnosed = {"recordings": {"bench": {"simulation": name}}}
        return checked({"recordings": {"bench": "bench"}, "diagnosis": diagnosed}, capsys)

    recording_folders.write_projections(Path("own.h5"), log=True)
    assert found("own.h5")[0] == 0
    recording_folders.write_projections(Path("own.h5"), log=True, data=recording_folders.line_integrals()[:, :, 1:])
    code, (line,) = found("own.h5")
    assert code == 1 and line.startswith("Error: own.h5: has 39 columns, but recording.yaml says scan.columns 40"), line
    code, (line,) = found("ct.nii.gz")
    assert code == 1 and "give a simulation of projections" in line, line


def test_nothing_is_cached_without_a_snakemake_folder(desk, capsys):
    assert checked(CT, capsys)[0] == 0 and not Path(".snakemake").exists()


BENEATH = {  # overlays on overlays, as stated in their first lines
    "every_scan": ["printed_phantom"],
    "multicentre": ["printed_phantom"],
    "paper_subset": ["paper"],
    "printed_groups": ["printed_phantom"],
}


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "config").glob("*.yaml")))
def test_shipped_configurations_have_no_mistake_but_files_to_fetch(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    names = [*BENEATH.get(name, []), name]
    lines, settings = read_config.read_configs([f"config/{name}.yaml" for name in names])
    assert not lines
    absent = ("no such", "make setup-proof")  # files to fetch, and the second simulator of the blind validation
    assert not [line for line in preflight.problems(settings) if not any(words in line for words in absent)]


def test_mistakes_stop_snakemake_before_any_job(desk):
    """The same list, and no output."""
    Path("my.yaml").write_text(yaml.safe_dump(CASES["files that are not there"][0]))
    arguments = ["-s", ROOT / "workflow" / "Snakefile", "--cores", "1", "--nolock", "--configfile", "my.yaml"]
    run = subprocess.run([warm.python(), "-m", "snakemake", *map(str, arguments)], capture_output=True, text=True)
    assert run.returncode == 1 and "Error: 3 mistakes" in run.stderr, run.stderr[-2000:]
    for line in CASES["files that are not there"][1]:
        assert line in run.stderr
    assert not Path("results").exists() and "Traceback" not in run.stderr


def test_several_mistakes_are_one_error_with_all_lines():
    with pytest.raises(InputErrors) as error:
        complete({"grid": {}, "sed": 1})
    assert len(error.value.lines) > 2 and "\n" not in str(error.value)
    assert printed(error.value).count("\n") == len(error.value.lines)
    assert printed(InputError("one")) == "Error: one"


# ---- size of the missing part --------------------------------------------------------------------

GRID = Grid((14, 34, 42), (3.0, 2.0, 2.0))


def whole(**changes):
    return from_mapping(ScanSettings, defaults_of("scan") | SCAN | changes)


@pytest.mark.parametrize("reach", [20.0, 55.5, 120.0])
@pytest.mark.parametrize("offset", [0.0, 1.5])
@pytest.mark.parametrize(
    "surface", [{}, {"detector": "cylindrical"}, {"detector": "cylindrical", "arc_radius_mm": 900.0}]
)
def test_suggested_columns_are_the_minimum(reach, offset, surface):
    """Compare with the field of view of the geometry."""
    scan = whole(column_offset_px=offset, **surface)
    columns = columns_for(reach, scan)
    radius = {
        n: scan_geometry(replace(scan, columns=n), 90, GRID).field_of_view_radius_mm for n in (columns - 1, columns)
    }
    assert radius[columns] >= reach > radius[columns - 1]
    assert columns_for(600.0, scan) is None


@pytest.mark.parametrize("changes", [{"trajectory": "circular", "rows": 4}, {"turns": 1.5, "rows": 6}])
def test_suggested_rows_are_the_minimum(changes):
    """Compare with the check in jobs."""
    scan = whole(**changes)
    mask = np.zeros(GRID.shape, bool)
    mask[1:13, 10:20, 5:30] = True
    points = points_of(GRID, {"roi": mask})["roi"]
    rows = rows_for(scan, 150, GRID, points)
    assert worst_share(replace(scan, rows=rows - 1), 150, GRID, points) < 1
    check_rois_seen(scan_geometry(replace(scan, rows=rows), 150, GRID), GRID, {"roi": mask})
    with pytest.raises(InputError, match="ROI roi is not seen"):
        check_rois_seen(scan_geometry(replace(scan, rows=rows - 1), 150, GRID), GRID, {"roi": mask})
