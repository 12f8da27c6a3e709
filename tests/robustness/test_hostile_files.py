"""DICOM, NIfTI and HDF5 with false headers: a volume or one line, and no more memory than the file can fill."""

import gzip
import resource

import h5py
import nibabel
import numpy as np
import phantom_files
import pydicom
import pytest
import recording_folders as folders
from hostile import EXAMPLES, outcome, outcomes
from pydicom.dataelem import RawDataElement

from benchmarks import fuzz_dicom
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.phantom.ct import read_hu
from virtual_phantom.phantom.dicom_series import find_series
from virtual_phantom.phantom.masks import open_regions
from virtual_phantom.recordings.provenance import series_facts
from virtual_phantom.recordings.reading import load_recording

HEADER = 348  # bytes, of NIfTI-1
pytestmark = pytest.mark.filterwarnings("ignore")  # from pydicom and numpy about values that are wrong on purpose


@pytest.fixture
def little_memory():
    """At most 2 GB more than now, so that an allocation by a false header fails."""
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2 * 10**9, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_header_with_a_huge_size_is_rejected_before_allocation(kind, suffix, tmp_path, little_memory):
    side = 32_000 if kind is nibabel.Nifti1Image else 10**6
    header = kind.header_class()
    header.set_data_dtype(np.int16)
    header.set_data_shape((side, side, side))
    content = header.binaryblock + bytes(1000)
    path = tmp_path / f"moon{suffix}"
    path.write_bytes(gzip.compress(content) if suffix.endswith("gz") else content)
    with pytest.raises(InputError, match=f"its header says {side} x {side} x {side} voxels"):
        read_nifti(path)


def test_any_nifti_header_gives_a_volume_or_one_line(tmp_path):
    path = tmp_path / "ct.nii"
    phantom_files.write_nifti_array(phantom_files.object_hu(), path)
    whole, random = path.read_bytes(), np.random.default_rng(0)
    for _ in range(4 * EXAMPLES):
        damaged = bytearray(whole)
        for place in random.integers(HEADER, size=random.integers(1, 6)):
            damaged[place] = random.choice([0, 1, 127, 128, 255, random.integers(256)])
        path.write_bytes(damaged)
        volume = outcome("NIfTI header", read_nifti, path)
        if volume is not None:
            assert all(np.isfinite(volume.grid.spacing)) and np.isfinite(volume.grid.centre_mm).all()


ODD_DICOM = ["", None, "0", "-1", "1e400", "nan", "a", "x" * 70, "1\\2", "1\\2\\3", "\x00"]
TAGS = ["ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "Rows", "Columns", "RescaleSlope"]
TAGS += ["RescaleIntercept", "KVP", "SliceThickness", "XRayTubeCurrent", "ConvolutionKernel", "SeriesInstanceUID"]
TAGS += ["BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation", "GantryDetectorTilt", "CTDIvol"]


def read(folder):
    image, facts = read_hu(folder), series_facts(find_series(folder))
    assert np.isfinite(image.array).all()
    return image, facts


def test_any_dicom_header_gives_a_volume_or_one_line(tmp_path):
    folder = tmp_path / "series"
    phantom_files.write_series(phantom_files.ct_slices()[:3], folder)
    contents = {path: path.read_bytes() for path in folder.iterdir()}
    random = np.random.default_rng(0)
    for number in range(EXAMPLES):
        for path, content in contents.items():
            path.write_bytes(content)
        path = list(contents)[random.integers(3)]
        if number % 2:
            dataset = pydicom.dcmread(path)
            tag = TAGS[random.integers(len(TAGS))]
            value = str(ODD_DICOM[random.integers(len(ODD_DICOM))]).encode()
            number = pydicom.tag.Tag(tag)
            vr = pydicom.datadict.dictionary_VR(number)[:2]
            dataset[number] = RawDataElement(number, vr, len(value), value, 0, False, True)
            dataset.save_as(path)
        else:
            damaged = bytearray(contents[path])
            for place in random.integers(132, 1200, size=random.integers(1, 4)):
                damaged[place] = random.integers(256)
            path.write_bytes(damaged)
        outcome("DICOM header", read, folder)


def test_slices_with_fewer_pixels_than_stated_are_rejected(tmp_path, little_memory):
    slices = phantom_files.ct_slices()[:3]
    for one in slices:
        one.Rows = one.Columns = 65_535
    with pytest.raises(InputError, match="65535 x 65535 pixels, which the file does not hold"):
        read_hu(tmp_path / phantom_files.write_series(slices, tmp_path / "series"))


@pytest.mark.parametrize("kind", ["SEG", "RTSTRUCT"])
def test_any_region_file_gives_a_mask_or_one_line(kind, tmp_path):
    path = tmp_path / "regions.dcm"
    if kind == "SEG":
        phantom_files.write_seg(phantom_files.ct_slices(), path)
    else:
        phantom_files.write_rtstruct(path)
    whole, random = path.read_bytes(), np.random.default_rng(0)

    def mask():
        regions = open_regions(path, phantom_files.CT_GRID)
        return [regions.mask(name) for name in phantom_files.BALLS]

    for number in range(EXAMPLES):
        damaged = bytearray(whole)
        for place in random.integers(132, len(whole), size=random.integers(1, 6)):
            damaged[place] = random.integers(256)
        path.write_bytes(damaged[: random.integers(132, len(whole))] if number % 5 == 0 else damaged)
        masks = outcome(kind, mask)
        assert masks is None or all(mask.shape == phantom_files.CT_GRID.shape for mask in masks)


def test_any_hdf5_gives_projections_or_one_line(tmp_path):
    folder, _ = folders.projections_folder(tmp_path / "bench")
    path = folder / "b.h5"
    whole, random = path.read_bytes(), np.random.default_rng(0)
    for number in range(EXAMPLES):
        damaged = bytearray(whole)
        for place in random.integers(4000 if number % 2 else len(whole), size=random.integers(1, 6)):
            damaged[place] = random.integers(256)
        path.write_bytes(damaged)
        outcome("HDF5", load_recording, folder)


def test_empty_dataset_with_a_huge_size_is_rejected(tmp_path, little_memory):
    scan = folders.SCAN | {
        "columns": 16_384,
        "column_pitch_mm": 0.02,
        "rows": 4096,
        "row_pitch_mm": 0.02,
        "views": 4000,
    }
    folder, content = folders.projections_folder(tmp_path / "bench")
    folders.write_yaml(folder, content | {"scan": scan, "repeats": ["a.h5"], "held_out": []})
    with h5py.File(folder / "a.h5", "w") as file:
        file.create_dataset("exchange/data", shape=(4000, 4096, 16_384), dtype="f4", chunks=(1, 64, 64)).attrs[
            "log"
        ] = True
    with pytest.raises(InputError, match="GB of memory"):
        load_recording(folder)


def test_damaged_dicom_attributes_never_change_a_phantom_silently(tmp_path):
    """A sample of benchmarks/fuzz_dicom.py, which runs 2000 cases."""
    for reader, result in fuzz_dicom.run_dicom(EXAMPLES, 1, tmp_path):
        outcomes[f"DICOM attributes, {reader}", result.outcome] += 1
        assert result.outcome not in fuzz_dicom.FAULTS, f"{result.damage}: {result.outcome}: {result.words}"
        assert "A^B" not in result.words
