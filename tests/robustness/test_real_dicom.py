"""DICOM files shipped with pydicom and nibabel, from many scanners and programs: read correctly, or rejected."""

from pathlib import Path

import nibabel
import numpy as np
import pydicom
import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.phantom import dicom_pixels
from virtual_phantom.phantom.dicom_files import not_dicom, read_header
from virtual_phantom.phantom.dicom_series import read_series
from virtual_phantom.phantom.masks import open_regions
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree

pytestmark = pytest.mark.filterwarnings("ignore")  # from pydicom about files that are wrong on purpose
SHIPPED = Path(pydicom.data.__file__).parent / "test_files"
FOLDERS = (SHIPPED.parent, Path(nibabel.__file__).parent / "nicom" / "tests" / "data")
FILES = sorted(
    path
    for folder in FOLDERS
    for path in folder.rglob("*")
    if path.is_file() and path.suffix not in (".py", ".pyc") and "TINY_ALPHA" not in path.parts
)
RESULTS = yaml.safe_load(Path(__file__).with_name("real_dicom.yaml").read_text(encoding="utf-8"))


def result(function):
    """Text of the error, or "read". Any exception but InputError is a fault."""
    try:
        function()
    except InputError as error:
        assert str(error).isprintable()
        return str(error)
    return "read"


def test_every_shipped_file_is_read_or_rejected_in_one_line(tmp_path):
    grid = Grid((2, 2, 2), (1.0, 1.0, 1.0))
    assert len(FILES) > 100
    for number, path in enumerate(FILES):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / path.name).symlink_to(path)
        result(lambda folder=folder: read_series(folder))
        result(lambda folder=folder: import_dicom_tree(folder, folder / "recording"))
        result(lambda path=path: open_regions(path, grid))


@pytest.mark.parametrize("name", RESULTS)
def test_file_is_read_or_rejected_for_its_reason(name, tmp_path):
    expected = RESULTS[name]
    source = next(folder / name for folder in (SHIPPED, *FOLDERS) if (folder / name).exists())
    folder = source
    if source.is_file():
        folder = tmp_path / "folder"
        folder.mkdir()
        (folder / source.name).symlink_to(source)
    found = result(lambda: read_series(folder))
    assert (found == "read") == expected.startswith("read"), found
    assert found == "read" or expected in found, found


@pytest.mark.parametrize(
    "name",
    "CT_small 693_J2KI J2K_pixelrep_mismatch MR_small MR_small_RLE MR_small_jp2klossless MR_small_jpeg_ls_lossless "
    "MR_small_bigendian MR_small_expb MR_small_implicit MR_small_padded image_dfl".split(),
)
def test_stored_values_equal_those_of_pydicom(name):
    path = SHIPPED / f"{name}.dcm"
    stored = dicom_pixels._stored(read_header(path))
    np.testing.assert_array_equal(stored, pydicom.dcmread(path).pixel_array)


def test_files_are_recognized_as_dicom_by_their_first_bytes():
    """As pydicom reads them, except files without any identifying attribute."""
    for path in FILES:
        if (
            path.suffix == ".dcm" and path.name != "no_meta.dcm"
        ):  # starts with an additional byte; pydicom finds nothing either
            assert not not_dicom(path), path
    for name in ("README.txt", "crayons.icc", "zipMR.gz", "test1.json", "rtplan.dump"):
        assert not_dicom(SHIPPED / name)
