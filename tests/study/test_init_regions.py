"""`virtual-phantom init` with files of regions of which some cannot be used:

the others are used, and the rest is named.
"""

import shutil
from pathlib import Path

import nibabel
import numpy as np
import phantom_files
import pytest
import structure_files
import yaml
from phantom_files import BALLS, ball, write_nifti_array
from structure_files import Z, circle, contour, structure_set

from virtual_phantom.base import console
from virtual_phantom.base.geometry import Grid
from virtual_phantom.cli import main
from virtual_phantom.cli.init.regions import read_regions, tissue_class
from virtual_phantom.io.volumes import read_nifti

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with a CT and masks of its two balls."""
    monkeypatch.chdir(tmp_path)
    write_nifti_array(phantom_files.object_hu(), "ct.nii.gz")
    Path("masks").mkdir()
    for name in BALLS:
        write_nifti_array(ball(name).astype(np.uint8), f"masks/{name}.nii.gz")
    return tmp_path


def read(labels, names=None, **options):
    return {region.name: region for region in read_regions(read_nifti("ct.nii.gz"), labels, names or {}, **options)}


def notes(capsys):
    return [line.removeprefix("Note: ") for line in capsys.readouterr().err.splitlines() if line.startswith("Note: ")]


def test_contour_outside_of_the_ct_leaves_the_other_regions(desk, capsys):
    organs = [
        (n, name, [contour(circle(radius, Z[k], x, y)) for k in range(5, 12)])
        for n, (name, radius, x, y) in enumerate([("bright", 7, 14, 8), ("dark", 6, -16, -10)], 1)
    ]
    outside = (3, "BODY", [contour(circle(60, z)) for z in Z])
    above = (4, "COUCH", [contour(circle(10, Z[-1] + 3 * k)) for k in range(1, 4)])
    structure_set(*organs, outside, above, (5, "marker", [contour([[0, 0, Z[5]]], "POINT")]), (6, "no", None))
    shutil.copytree(ROOT / "config", "config")
    with console.printed_notes():
        assert list(read("rt.dcm", rois=["bright", "2"])) == list(BALLS)
    assert not notes(capsys)
    assert main.main(["init", "ct.nii.gz", "--labels", "rt.dcm", "--size", "quick"]) == 0
    lines = notes(capsys)
    left_out = ["BODY is skipped", "COUCH is skipped", "marker is skipped", "rt.dcm"]
    assert [line.split(":")[0] for line in lines] == left_out
    assert "leaves the CT" in lines[0] and "does not lie in a slice of the CT" in lines[1]
    assert lines[3] == "rt.dcm: 1 region without voxels skipped: no"
    assert [roi["name"] for roi in yaml.safe_load(Path("my.yaml").read_text())["phantom"]["ct"]["rois"]] == list(BALLS)
    assert main.main(["check", "my.yaml"]) == 0 and not notes(capsys)
    Path("my.yaml").unlink()
    Path("my.png").unlink()
    assert main.main(["init", "ct.nii.gz", "--labels", "rt.dcm", "--rois", "bright,BODY"]) == 1
    assert "a contour of ROI BODY" in capsys.readouterr().err and not Path("my.yaml").exists()


def test_folder_of_masks_with_other_files(desk, capsys):
    write_nifti_array(np.ones((5, 5, 5), np.uint8), "masks/other.nii.gz", grid=Grid((5, 5, 5), (3.0, 2.0, 2.0)))
    Path("masks/broken.nii.gz").write_bytes(b"\x1f\x8b nothing")
    Path("masks/._bright.nii.gz").write_bytes(b"\x00\x05\x16\x07Mac OS X")
    Path("masks/.hidden.nii").write_text("")
    Path("masks/readme.txt").write_text("masks")
    write_nifti_array(phantom_files.object_hu() + np.arange(48), "masks/ct.nii.gz")
    write_nifti_array(0 * ball("dark").astype(np.uint8), "masks/empty.nii.gz")
    shutil.copy("masks/bright.nii.gz", "masks/BRIGHT.NII.GZ")
    nibabel.save(nibabel.load("masks/bright.nii.gz"), "masks/bright.nii")
    nibabel.save(
        nibabel.Nifti1Image((ball("bright") ^ ball("dark")).T.astype(np.uint8), phantom_files.CT_GRID.affine),
        "masks/Dark.nii",
    )
    with console.printed_notes():
        found = read("masks")
    assert list(found) == ["bright", "dark_1", "dark_2"]
    sizes = sorted(int(one.voxels) for one in found.values())
    assert sizes == sorted([ball("bright").sum(), ball("dark").sum(), (ball("bright") ^ ball("dark")).sum()])
    text = "\n".join(notes(capsys))
    for line in (
        "other is skipped: masks/other.nii.gz: lies on another grid than the CT",
        "broken is skipped: masks/broken.nii.gz: cannot be read as NIfTI",
        "ct is skipped: masks/ct.nii.gz: has ",
        "masks: 1 file without masks skipped: readme.txt",
        "masks: 1 region without voxels skipped: empty",
        "is the same mask as masks/",
        "several regions have the name dark: 'Dark' is called dark_",
    ):
        assert line in text
    assert "._bright" not in text and "hidden" not in text
    assert list(read("masks", rois=["Dark"])) == ["dark_1"]


def test_folder_of_structure_sets_with_other_files(desk, capsys):
    Path("drawn").mkdir()
    whole = Path(phantom_files.write_rtstruct("rt.dcm")).read_bytes()
    Path("drawn/a.dcm").write_bytes(whole[132:])  # without the preamble, as some systems write it
    Path("drawn/b.dcm").write_bytes(whole[:400])
    Path("drawn/c.txt").write_bytes(b"")
    with console.printed_notes():
        assert list(read("drawn")) == list(BALLS)
    assert "drawn: 2 files without masks skipped: b.dcm, c.txt" in notes(capsys)


def test_folder_without_readable_masks_gives_the_reason(desk):
    for path in Path("masks").iterdir():
        path.write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"masks: no region can be read; the first: masks/bright.nii.gz: has no NIfTI"):
        read("masks")


@pytest.mark.parametrize(
    ("own", "called"),
    [
        (["Leber", "Größe", "foie gras", "Łokieć"], ["leber", "grosse", "foie_gras", "lokiec"]),
        (["печень", "селезёнка"], ["region_1", "region_2"]),
        (["肝 L", "脾 L"], ["region_1", "region_2"]),
        (["liver", "Liver", " liver "], ["liver_1", "liver_2", "liver_3"]),
        (["a-b", "a b", "a_b_2"], ["a_b_1", "a_b_3", "a_b_2"]),
        (["x" * 70 + "1", "x" * 70 + "2"], ["x" * 54 + "_1", "x" * 54 + "_2"]),
        (["é", "è"], ["e_1", "e_2"]),
    ],
)
def test_different_roi_names_stay_different_in_the_configuration(own, called, desk, capsys):
    rois = [(n, name, [contour(circle(6 + n, Z[6]))]) for n, name in enumerate(own, 1)]
    structure_set(*rois, charset="ISO_IR 192")
    with console.printed_notes():
        found = read("rt.dcm")
    assert list(found) == called
    assert [one.voxels for one in found.values()] == [structure_files.disc(7 + n).sum() for n in range(len(own))]
    assert ("--names LABEL=NAME" in "".join(notes(capsys))) == called[0].endswith("_1")
    assert list(read("rt.dcm", {"2": "mine"}))[1] == "mine"
    assert tissue_class("region_1") == "region_1" and tissue_class("liver_2") == "liver"


def test_gaps_are_filled_by_an_option_that_the_configuration_keeps(desk, capsys):
    shutil.copytree(ROOT / "config", "config")
    rois = [
        (n, name, [contour(circle(radius, Z[k], x, y)) for k in range(4, 13, 2)])
        for n, (name, radius, x, y) in enumerate([("bright", 7, 14, 8), ("dark", 6, -16, -10)], 1)
    ]
    structure_set(*rois)
    words = ["init", "ct.nii.gz", "--labels", "rt.dcm", "--size", "quick", "--force"]
    assert main.main(words) == 0
    striped = notes(capsys)
    assert all("4 of its 9 slices" in one and "--fill-gaps" in one for one in striped) and len(striped) == 2
    assert main.main([*words, "--fill-gaps"]) == 0
    assert "4 of its 9 slices" in notes(capsys)[0]
    settings = yaml.safe_load(Path("my.yaml").read_text())
    assert all(roi["fill_gaps"] for roi in settings["phantom"]["ct"]["rois"])
    assert "--fill-gaps" in settings["trial"]
    assert main.main(["check", "my.yaml"]) == 0
    whole = read("rt.dcm", fill_gaps=True)
    assert [one.voxels for one in whole.values()] == [
        9 * structure_files.disc(7, 14, 8).sum(),
        9 * structure_files.disc(6, -16, -10).sum(),
    ]


def test_long_work_is_reported_every_few_seconds(monkeypatch, capsys):
    clock = iter([0, 1, 5.5, 6, 20, 21, 30])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    console.progress("reading regions", 0, 5)  # no report in a job
    with console.printed_notes():
        for done in range(5):
            console.progress("reading regions", done, 5)
        for done in range(2):
            console.progress("something else", done, 2)
    assert capsys.readouterr().err.splitlines() == [
        "reading regions: 2 of 5",
        "reading regions: 4 of 5",
        "something else: 1 of 2",
    ]
