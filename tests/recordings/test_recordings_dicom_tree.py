"""A tree of DICOM files: every scan in it becomes a repeat, or a note gives the reason."""

import os
import shutil

import nibabel
import numpy as np
import phantom_files
import pytest
from phantom_files import CT_GRID, ct_slices, object_hu, write_series

from virtual_phantom.base.errors import InputError, lines_of
from virtual_phantom.recordings.importers.command import run
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree
from virtual_phantom.recordings.reading import load_recording


def scan(folder, seed, kernel="Br38f", **attributes):
    """A series with noise."""
    noise = np.random.default_rng(seed).normal(0, 10, CT_GRID.shape)
    slices = ct_slices()
    for one, hu in zip(slices, noise, strict=True):
        pixels = np.frombuffer(one.PixelData, "<u2").reshape(hu.shape) + hu
        one.PixelData = pixels.clip(0, 4095).astype("<u2").tobytes()
        one.ConvolutionKernel, one.KVP = kernel, 120
        for name, value in attributes.items():
            setattr(one, name, value)
    folder.mkdir(parents=True, exist_ok=True)
    write_series(slices, folder)
    return folder


def means(tree, tmp_path, **options):
    """Mean of the voxels per repeat, which identifies the scan."""
    recording = import_dicom_tree(tree, tmp_path / "recording", **options)
    return [float(image.array.mean()) for image in recording.repeats]


@pytest.fixture
def tree(tmp_path):
    for number in range(3):
        scan(tmp_path / "tree" / f"scan{number}", number)
    return tmp_path / "tree"


@pytest.fixture
def expected(tree, tmp_path):
    found = [means(tree / f"scan{number}", tmp_path / f"alone{number}")[0] for number in range(3)]
    assert len(set(found)) == 3
    return found


@pytest.fixture(autouse=True)
def _logged(caplog):
    caplog.clear()


def notes(caplog):
    return [record.getMessage() for record in caplog.records if "notes" in record.name]


@pytest.mark.parametrize("kind", ["regions first", "no preamble", "loop", "linked", "deep", "one folder", "upper case"])
def test_three_scans_are_three_repeats(kind, tree, expected, tmp_path, caplog):
    caplog.clear()
    one = tree / "scan1"
    if kind == "regions first":
        phantom_files.write_rtstruct(one / "000.dcm.RS")
        phantom_files.write_seg(ct_slices(), one / "000_seg")
    elif kind == "no preamble":
        for path in one.iterdir():
            path.write_bytes(path.read_bytes()[132:])
    elif kind == "loop":
        (one / "again").symlink_to(tree, target_is_directory=True)
    elif kind == "linked":
        shutil.move(one, tmp_path / "archive" / "patient")
        one.symlink_to(tmp_path / "archive", target_is_directory=True)
    elif kind == "deep":
        os.renames(one, tmp_path / "one")
        os.renames(tmp_path / "one", one / "a" / "b" / "c")
    elif kind == "one folder":
        for number in (0, 1, 2):
            for path in (tree / f"scan{number}").iterdir():
                os.renames(path, tree / "all" / f"{number}{path.name}")
    else:
        for path in one.iterdir():
            path.rename(path.with_suffix(".IMA"))
    assert means(tree, tmp_path) == expected
    expected_notes = {
        "regions first": [
            f"{tree}: not used: scan1/000.dcm.RS: SOP class is RT Structure Set Storage, not CT",
            f"{tree}: not used: scan1/000_seg: SOP class is Segmentation Storage, not CT",
        ],
        "loop": [f"{tree}: not used: scan1/again: a link to a folder that was read before"],
    }
    assert notes(caplog) == expected_notes.get(kind, [])


def test_copy_of_a_scan_is_no_repeat(tree, expected, tmp_path, caplog):
    shutil.copytree(tree / "scan1", tree / "scan1_copy")
    assert means(tree, tmp_path) == expected
    assert f"{tree}/scan1_copy: not used: copy of {tree}/scan1" in notes(caplog)


def test_series_spread_over_folders_is_one_repeat(tree, expected, tmp_path):
    for number, path in enumerate(sorted((tree / "scan1").iterdir())):
        os.renames(path, tree / "scan1" / f"DIR{number // 5}" / path.name)
    assert means(tree, tmp_path) == expected


def test_kernel_selects_among_series_of_one_folder(tree, expected, tmp_path):
    sharp = scan(tmp_path / "sharp", 7, kernel="Br59d", SeriesNumber=2)
    for path in sharp.iterdir():
        path.rename(tree / "scan1" / f"sharp{path.name}")
    assert means(tree, tmp_path, kernel="Br38f") == expected
    with pytest.raises(
        InputError, match=r"scan1 \(series 2 of 14 slices, kernel Br59d, 3 mm, sharp001.dcm\): kernel is"
    ):
        means(tree, tmp_path / "again")


def test_unused_folders_are_named(tree, expected, tmp_path, caplog):
    caplog.clear()
    iodine = scan(tree / "iodine", 8, RescaleType="MGML")
    scout = scan(tree / "scout", 9, ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])
    for path in sorted(scout.iterdir())[1:]:
        path.unlink()
    (tree / "notes").mkdir()
    (tree / "notes" / "readme.txt").write_text("text")
    assert means(tree, tmp_path) == expected
    assert notes(caplog) == [
        f"{tree}: not used: 14 files, the first of them {iodine.name}/001.dcm: RescaleType is MGML, not HU",
        f"{tree}: not used: notes/readme.txt: not DICOM",
        f"{tree}: not used: scout/001.dcm: ImageType is LOCALIZER",
    ]


def test_rounding_in_headers_makes_no_difference(tmp_path):
    tree = tmp_path / "tree"
    scan(tree / "a", 0)
    scan(tree / "b", 1, PixelSpacing=[2.000001, 2], SliceThickness=3.00001, KVP=120.00001)
    recording = import_dicom_tree(tree, tmp_path / "recording")
    assert len(recording.repeats) == 2 and recording.grid.matches(CT_GRID, 0.02)
    np.testing.assert_allclose(np.mean([repeat.array for repeat in recording.repeats]), object_hu().mean(), atol=3)


@pytest.mark.filterwarnings("ignore:The value length")  # text that is too long on purpose
@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"Manufacturer": "B" * 200}, "Manufacturer is not valid DICOM text"),
        ({"SpiralPitchFactor": float("inf")}, "SpiralPitchFactor is not a finite number"),
    ],
)
def test_wrong_attribute_is_named(attributes, message, tmp_path):
    with pytest.raises(InputError, match=message):
        means(scan(tmp_path / "tree", 0, **attributes), tmp_path)


def test_impossible_values_are_reported_and_omitted(tmp_path, caplog):
    """Scanners write 0 for unknown values."""
    known = {"DistanceSourceToPatient": 0, "DistanceSourceToDetector": 1500, "SpiralPitchFactor": 0, "CTDIvol": -1}
    recording = import_dicom_tree(scan(tmp_path / "tree" / "scan", 0, **known), tmp_path / "recording")
    content = recording.document.content
    assert content["scan"] == {"source_to_detector_mm": 1500} and content["nominal"]["tube_kvp"] == 120
    assert not {"pitch", "dose_mgy"} & content["nominal"].keys()
    (line,) = (message for message in caplog.messages if "omitted" in message)
    assert "pitch (0.0), dose_mgy (-1.0), source_to_isocentre_mm (0.0)" in line


@pytest.mark.parametrize(
    ("change", "check", "words"),
    [
        ({"RescaleIntercept": 0}, "hu", "has no value below 0, so these are not HU"),
        ({"RescaleIntercept": -2048}, "hu", "air is at about -202"),
        ({"PixelSpacing": [0.2, 0.2]}, "size", "where at least 60 mm are expected"),
    ],
)
def test_series_not_in_hu_is_named_and_can_be_overruled(change, check, words, tmp_path):
    folder = scan(tmp_path / "tree" / "a", 1, **change)
    target = tmp_path / "recording"
    with pytest.raises(InputError) as error:
        import_dicom_tree(folder, target)
    (line,) = lines_of(error.value)
    assert line.startswith(f"{folder}: ") and words in line and line.endswith(f"not_checked: [{check}])")
    assert not target.exists()
    assert run(["dicom", str(folder), str(target), "--not-checked", check]) == 0
    assert load_recording(target).document.content["not_checked"] == [check]
    with pytest.raises(InputError, match="--not-checked: there is no check 'sizes'; did you mean 'size'"):
        import_dicom_tree(folder, tmp_path / "other", not_checked=["sizes"])


def test_file_instead_of_a_folder_is_named(tmp_path):
    folder = scan(tmp_path / "a", 1)
    with pytest.raises(InputError, match=r"001.dcm: is one DICOM file; use the top folder of a tree of DICOM series"):
        import_dicom_tree(folder / "001.dcm", tmp_path / "b")
    (tmp_path / "a.zip").write_bytes(b"PK" + bytes(200))
    with pytest.raises(InputError, match=r"a.zip: is an archive; unpack it to use what is in it; use the top"):
        import_dicom_tree(tmp_path / "a.zip", tmp_path / "b")


def test_imported_scan_keeps_its_rotation_so_that_its_regions_fit(tmp_path):
    turn, slices = np.radians(0.9), ct_slices()
    across, along = np.array([0, np.cos(turn), np.sin(turn)]), np.array([0, -np.sin(turn), np.cos(turn)])
    for k, one in enumerate(slices):
        position = np.array([float(one.ImagePositionPatient[0]), 40.0, 300.0]) - across * 39 + along * 3 * (k - 6.5)
        one.ImagePositionPatient = [round(float(value), 6) for value in position]
        one.ImageOrientationPatient = [1, 0, 0, *(round(float(value), 8) for value in across)]
    write_series(slices, tmp_path / "tree")
    recording = import_dicom_tree(tmp_path / "tree", tmp_path / "recording")
    affine = nibabel.load(tmp_path / "recording" / "repeat01.nii.gz").affine
    assert affine[:3, 1] / 2 == pytest.approx([0, np.cos(turn), -np.sin(turn)], abs=1e-5)  # rows in RAS
    assert affine == pytest.approx(recording.grid.drawn_affine, abs=1e-4)
