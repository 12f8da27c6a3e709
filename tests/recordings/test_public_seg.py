"""Regions in the format of the published ones: written by pydicom-seg 0.4.1 and read by the library."""

import os
import subprocess
from pathlib import Path

import numpy as np
import public_files
import pydicom
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.io.dicom_export import lps
from virtual_phantom.phantom.dicom_series import read_series
from virtual_phantom.phantom.masks import open_regions

HERE = Path(__file__).parent
WRITTEN = HERE / "pydicom_seg_0_4_1.dcm"  # by write_with_pydicom_seg.py, of some_masks() on scan 801
PYTHON = os.environ.get("PYDICOM_SEG_PYTHON")  # of an environment of environment-pydicom-seg.txt


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    """CT of scan 801 with files in random order."""
    folder = tmp_path_factory.mktemp("series")
    (scan,) = public_files.listed("801")
    slices = public_files.ct_slices(scan, public_files.some_image())
    for one in slices:
        one.save_as(folder / f"{one.SOPInstanceUID[-8:]}.dcm", enforce_file_format=True)
    return scan, slices, folder


def compare(path, folder):
    """Compare regions of a file with the masks that were written."""
    regions = open_regions(path, read_series(folder).grid)
    assert list(regions.list_regions().values()) == list(public_files.SEGMENTS)
    for name, mask in public_files.some_masks().items():
        np.testing.assert_array_equal(regions.mask(name), mask, name)
    with pytest.raises(InputError, match="there are: .*cyst1"):
        regions.mask("spleen")


def test_regions_written_by_pydicom_seg_are_read_by_name(series):
    _, _, folder = series
    dataset = pydicom.dcmread(WRITTEN)
    assert dataset.ManufacturerModelName == "https://github.com/razorx89/pydicom-seg"
    # Empty frames are omitted; the others are sorted by segment, opposite to the order of the CT's instances.
    assert dataset.NumberOfFrames == 6 * 3 + 3 < 6 * len(list(folder.iterdir()))
    compare(WRITTEN, folder)


def test_substitute_file_is_read_in_the_same_way(series, tmp_path):
    scan, slices, folder = series
    path = tmp_path / "seg.dcm"
    public_files.seg(scan, slices, public_files.some_masks()).save_as(path, enforce_file_format=True)
    compare(path, folder)
    actual, theirs = pydicom.dcmread(path), pydicom.dcmread(WRITTEN)
    assert actual.NumberOfFrames == theirs.NumberOfFrames


@pytest.mark.skipif(PYTHON is None, reason="PYDICOM_SEG_PYTHON names no Python that has pydicom-seg 0.4.1")
def test_pydicom_seg_writes_the_stored_file(series, tmp_path):
    scan, _, folder = series
    masks = public_files.some_masks()
    labels = sum(number * lps(mask).astype(np.uint8) for number, mask in enumerate(masks.values(), start=1))
    np.savez(tmp_path / "labels.npz", labels=labels, names=np.array(list(masks)))
    script, out = HERE / "write_with_pydicom_seg.py", tmp_path / "seg.dcm"
    command = [PYTHON, str(script), str(folder), str(tmp_path / "labels.npz"), str(out), scan.seg.uid]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(command, check=True, timeout=120, env=environment)
    compare(out, folder)
    stored, fresh = pydicom.dcmread(WRITTEN), pydicom.dcmread(out)
    assert stored.PixelData == fresh.PixelData
    for actual, theirs in zip(
        stored.PerFrameFunctionalGroupsSequence, fresh.PerFrameFunctionalGroupsSequence, strict=True
    ):
        assert actual.PlanePositionSequence == theirs.PlanePositionSequence
        assert actual.SegmentIdentificationSequence == theirs.SegmentIdentificationSequence
