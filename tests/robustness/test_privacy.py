"""Patient data in DICOM headers are in no file, log or message."""

import gzip
import json
import logging
import warnings
from pathlib import Path

import phantom_files
import pydicom
import pytest
import recording_folders as folders
from pydicom.dataelem import RawDataElement
from pydicom.tag import Tag

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.phantom import ct
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import readable, summarize_recording, summary_table

MARK = "Planted"
# Patient, staff, place and time: PS3.15, table E.1-1, removes all of them.
PERSONAL = """PatientName PatientID PatientBirthDate PatientSex PatientAge PatientAddress PatientComments PatientWeight
OtherPatientIDs OtherPatientNames PatientMotherBirthName EthnicGroup Occupation AdditionalPatientHistory MilitaryRank
PatientTelephoneNumbers ReferringPhysicianName PerformingPhysicianName OperatorsName NameOfPhysiciansReadingStudy
InstitutionName InstitutionAddress InstitutionalDepartmentName StationName StudyDescription SeriesDescription StudyID
AccessionNumber StudyDate StudyTime SeriesDate AcquisitionDate ContentDate AcquisitionTime ProtocolName
DeviceSerialNumber RequestedProcedureDescription ImageComments ContentCreatorName ReviewerName StructureSetLabel
StructureSetName StructureSetDate SoftwareVersions CurrentPatientLocation AdmissionID""".split()


def plant(path: Path) -> None:
    """Put the mark into every personal attribute of a file; dates and numbers become invalid."""
    dataset = pydicom.dcmread(path)
    for keyword in PERSONAL:
        tag = Tag(keyword)
        value = f"{MARK}^{keyword}".encode()
        value += b" " * (len(value) % 2)
        vr = pydicom.datadict.dictionary_VR(tag)
        dataset[tag] = RawDataElement(tag, vr, len(value), value, 0, False, True)
    private = dataset.private_block(0x0011, "Maker", create=True)
    private.add_new(1, "LO", f"{MARK} in private")
    dataset.save_as(path)
    assert path.read_bytes().count(MARK.encode()) > len(PERSONAL)


@pytest.fixture
def planted(tmp_path):
    slices = phantom_files.ct_slices()
    series = Path(phantom_files.write_series(slices, tmp_path / "series"))
    phantom_files.write_seg(slices, tmp_path / "seg.dcm")
    phantom_files.write_rtstruct(tmp_path / "struct.dcm")
    for path in (*series.iterdir(), tmp_path / "seg.dcm", tmp_path / "struct.dcm"):
        plant(path)
    return tmp_path


@pytest.fixture
def no_mark_printed(capfd, caplog):
    """Fail if the mark is in the output, a log or a warning of the test."""
    caplog.set_level(logging.DEBUG)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    assert MARK not in "".join(capfd.readouterr()) + caplog.text + "".join(str(one.message) for one in caught)


def contents(folder: Path) -> bytes:
    """Contents of all files under a folder, with their names; compressed files are unpacked."""
    parts = []
    for path in (path for path in folder.rglob("*") if path.is_file()):
        raw = path.read_bytes()
        parts += [str(path.relative_to(folder)).encode(), gzip.decompress(raw) if path.suffix == ".gz" else raw]
    assert parts
    return b"\n".join(parts)


@pytest.mark.parametrize("regions", ["seg.dcm", "struct.dcm"])
def test_phantom_of_dicom_has_no_patient_data(regions, planted, no_mark_printed):
    rois = [{"name": name, "tissue_class": name, "label": name} for name in phantom_files.BALLS]
    settings = {"image": str(planted / "series"), "labels": str(planted / regions), "rois": rois}
    made = ct.load_phantom(ct.read_settings(settings), Grid((10, 44, 52), (3.0, 2.0, 2.0)), 1)
    phantom.write_phantom(made, planted / "results" / "phantom")
    assert MARK.encode() not in contents(planted / "results")


def test_recording_of_dicom_has_no_patient_data(planted, no_mark_printed):
    folder = planted / "scanner"
    content = {"name": "scanner", "kind": "images", "repeats": ["series"], "labels": "seg.dcm"}
    content["rois"] = [{"name": "bright", "tissue_class": "x", "label": "bright"}]
    folders.write_yaml(folder, content)
    for name in ("series", "seg.dcm"):
        (planted / name).rename(folder / name)
    found = summarize_recording(load_recording(folder))
    assert found["content"]["rois"]
    assert MARK not in json.dumps(found) + readable(summary_table({"scanner": found}))


def test_imported_recording_has_no_patient_data(planted, no_mark_printed):
    import_dicom_tree(planted / "series", planted / "made")
    assert MARK.encode() not in contents(planted / "made")


@pytest.mark.parametrize("spoil", ["cut", "modality", "tilt", "doubled"])
def test_messages_on_a_broken_series_name_files_and_no_patient_data(spoil, planted, no_mark_printed):
    paths = sorted((planted / "series").iterdir())
    if spoil == "cut":
        paths[3].write_bytes(paths[3].read_bytes()[:2200])
    else:
        dataset = pydicom.dcmread(paths[3])
        if spoil == "modality":
            dataset.Modality = "MR"
        elif spoil == "tilt":
            dataset.ImageOrientationPatient = [1, 0, 0, 0, 0.9, 0.4]
        else:
            dataset.ImagePositionPatient = pydicom.dcmread(paths[4]).ImagePositionPatient
        dataset.save_as(paths[3])
    with pytest.raises(InputError) as error:
        ct.read_hu(planted / "series")
    assert MARK not in str(error.value) and "\n" not in str(error.value)
