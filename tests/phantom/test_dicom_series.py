"""Selection of CT slices and their values in HU: read correctly, or rejected in one line that names the file."""

import os
import zipfile

import numpy as np
import phantom_files
import pydicom
import pytest
from phantom_files import CT_GRID, ct_slices, object_hu, write_series
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    EnhancedCTImageStorage,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    JPEGLSLossless,
    MediaStorageDirectoryStorage,
    MRImageStorage,
    RLELossless,
    RTDoseStorage,
)

from virtual_phantom.base.errors import InputError
from virtual_phantom.phantom.dicom_series import read_series


@pytest.fixture
def slices():
    return ct_slices()


@pytest.fixture
def notes(caplog):
    """Notes of a test, without the folder at the beginning."""
    return lambda: [record.getMessage().split(": ", 1)[1] for record in caplog.records if "notes" in record.name]


def assert_object(folder, atol=1e-3):
    volume = read_series(folder)
    assert volume.grid.matches(CT_GRID, 0.02)
    np.testing.assert_allclose(volume.array, object_hu(), atol=atol)


def refused(folder, message):
    with pytest.raises(InputError) as error:
        read_series(folder)
    assert message in str(error.value) and str(error.value).isprintable(), str(error.value)


def each(slices, **attributes):
    for one in slices:
        for name, value in attributes.items():
            setattr(one, name, value)
    return slices


# ---- selection of files --------------------------------------------------------------------------


def other_dicom(path, kind, **attributes):
    one = pydicom.Dataset()
    one.file_meta = pydicom.dataset.FileMetaDataset()
    one.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian
    one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID = kind
    one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID = pydicom.uid.generate_uid()
    one.SeriesInstanceUID = pydicom.uid.generate_uid()
    for name, value in attributes.items():
        setattr(one, name, value)
    one.save_as(path, enforce_file_format=True)


def test_files_of_other_kinds_are_skipped_and_named(slices, tmp_path, notes):
    folder = tmp_path / "series"
    write_series(slices, folder)
    other_dicom(folder / "000_DICOMDIR", MediaStorageDirectoryStorage)
    other_dicom(folder / "000_dose.dcm", RTDoseStorage, Modality="RTDOSE", Rows=40, Columns=48)
    other_dicom(folder / "mr1.dcm", MRImageStorage, Modality="MR")
    other_dicom(folder / "mr2.dcm", MRImageStorage, Modality="MR")
    phantom_files.write_rtstruct(folder / "000_RS.dcm")
    (folder / "._001.dcm").write_bytes(b"\x00\x05\x16\x07 Mac")
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf")
    (folder / "report.txt").write_text("a report")
    with zipfile.ZipFile(folder / "more.zip", "w") as archive:
        archive.writestr("a", "b")
    (folder / "empty").mkdir()
    (folder / "inner").mkdir()
    (folder / "inner" / "a").write_text("a")
    assert_object(folder)
    assert sorted(notes()) == sorted(
        [
            "folders in it are not read (inner)",
            "not used: 2 files, the first of them ._001.dcm: a hidden or system file",
            "not used: 000_DICOMDIR: SOP class is Media Storage Directory Storage, not CT",
            "not used: 000_RS.dcm: SOP class is RT Structure Set Storage, not CT",
            "not used: 000_dose.dcm: SOP class is RT Dose Storage, not CT",
            "not used: 2 files, the first of them mr1.dcm: SOP class is MR Image Storage, not CT",
            "not used: more.zip: an archive; unpack it to use what is in it",
            "not used: report.txt: not DICOM",
        ]
    )


@pytest.mark.parametrize("kind", ["no preamble", "some without", "no modality", "class in meta", "links", "names"])
def test_every_slice_is_found(kind, slices, tmp_path, notes):
    folder = tmp_path / "series"
    if kind == "no modality":
        for one in slices:
            del one.Modality
    write_series(slices, folder)
    for number, path in enumerate(sorted(folder.iterdir())):
        if kind == "no preamble" or (kind == "some without" and number > 9):
            path.write_bytes(path.read_bytes()[132:])
        elif kind == "class in meta":
            one = pydicom.dcmread(path)
            del one.SOPClassUID
            one.save_as(path)
        elif kind == "links":
            os.renames(path, tmp_path / "archive" / path.name)
            folder.mkdir(exist_ok=True)
            path.symlink_to(tmp_path / "archive" / path.name)
        elif kind == "names":
            path.rename(folder / f"1.2.840.{number}{['', '.IMA', '.DCM', '.dicom'][number % 4]}")
    assert_object(folder)
    assert not notes()


@pytest.mark.parametrize(
    "syntax", [ImplicitVRLittleEndian, ExplicitVRBigEndian, DeflatedExplicitVRLittleEndian, RLELossless, JPEGLSLossless]
)
@pytest.mark.parametrize("signed", [False, True])
def test_every_transfer_syntax_gives_the_stored_values(syntax, signed, slices, tmp_path):
    folder = tmp_path / "series"
    folder.mkdir()
    for number, one in enumerate(slices):
        if signed:
            one.PixelRepresentation, one.BitsStored, one.HighBit, one.RescaleIntercept = 1, 16, 15, 0
            one.PixelData = (np.frombuffer(one.PixelData, "<u2").astype("<i2") - 1024).tobytes()
        if syntax in (RLELossless, JPEGLSLossless):
            one.compress(syntax, generate_instance_uid=False)
        else:
            one.file_meta.TransferSyntaxUID = syntax
            pixels = np.frombuffer(one.PixelData, "<u2")
            one["PixelData"].VR = "OW"
            one.PixelData = (pixels.byteswap() if syntax == ExplicitVRBigEndian else pixels).tobytes()
        little, implicit = syntax != ExplicitVRBigEndian, syntax == ImplicitVRLittleEndian
        if one.file_meta.TransferSyntaxUID.is_encapsulated:
            one.save_as(folder / f"{number}")
        else:
            one.save_as(folder / f"{number}", implicit_vr=implicit, little_endian=little)
    assert_object(folder)


def test_values_agree_with_pydicom(slices, tmp_path, notes):
    """Slopes that differ, MONOCHROME1, and pydicom's own rescale."""
    for k, one in enumerate(slices):
        one.PhotometricInterpretation, one.RescaleSlope, one.RescaleIntercept = "MONOCHROME1", 1 + k / 8, -1024 - 7 * k
    write_series(slices, tmp_path / "series")
    array = read_series(tmp_path / "series").array
    for k, one in enumerate(slices):
        expected = pydicom.pixels.apply_rescale(one.pixel_array, one)
        np.testing.assert_allclose(array[k], expected[::-1, ::-1], atol=1e-3)
    assert notes() == [
        "RescaleSlope and RescaleIntercept differ between slices; each slice is read with its own",
        "PhotometricInterpretation is MONOCHROME1 in 14 of 14 slices: it only concerns the display; "
        "values are used as stored",
    ]


def test_rescale_that_differs_in_a_few_slices_is_rejected(slices, tmp_path):
    slices[5].RescaleIntercept = -1000
    message = "009.dcm: RescaleSlope and RescaleIntercept are 1 and -1000, but 1 and -1024 in most slices; correct them"
    refused(write_series(slices, tmp_path / "series"), message)


def test_damaged_slice_is_rejected_and_not_skipped(slices, tmp_path):
    folder = tmp_path / "series"
    write_series(slices, folder)
    for content, message in ((b"", "an empty file, but named like the slices"), (b"abc", "not DICOM, but named")):
        (folder / "015.DCM").write_bytes(content)
        refused(folder, f"015.DCM: {message}")
    (folder / "015.DCM").unlink()
    (folder / "015.dcm").symlink_to(folder / "nowhere.dcm")
    refused(folder, "015.dcm: a link to a file that is missing, but named like the slices")


@pytest.mark.parametrize("length", [300, 700, 1000, 3000])
def test_truncated_slice_is_rejected_at_the_end_of_the_series_too(length, slices, tmp_path):
    folder = tmp_path / "series"
    write_series(slices, folder)
    (folder / "001.dcm").write_bytes((folder / "001.dcm").read_bytes()[:length])
    refused(folder, "001.dcm: ")


@pytest.mark.parametrize("number", [0, 6, 13])
@pytest.mark.parametrize(
    ("attributes", "reason"),
    [
        ({"SOPClassUID": MRImageStorage}, "SOP class is MR Image Storage, not CT"),
        ({"Modality": "PT"}, "modality is PT, not CT"),
        ({"ImageType": ["DERIVED", "SECONDARY", "MPR", "IODINE"]}, "ImageType is IODINE, not an image in HU"),
        ({"RescaleType": "PCT"}, "RescaleType is PCT, not HU"),
        ({"PhotometricInterpretation": "RGB"}, "PhotometricInterpretation is neither"),
    ],
)
def test_slice_of_another_kind_is_always_reported(number, attributes, reason, slices, tmp_path):
    each(slices[number : number + 1], **attributes)
    folder = write_series(slices, tmp_path / "series")
    refused(folder, f"{14 - number:03d}.dcm: {reason}")
    refused(folder, "continues the CT series")


# ---- several series ------------------------------------------------------------------------------


def test_scouts_and_single_images_are_skipped_if_there_is_a_series(slices, tmp_path, notes):
    folder = tmp_path / "series"
    write_series(slices, folder)
    scout = each(
        ct_slices()[:1], ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"], ImageOrientationPatient=[0, 1, 0, 0, 0, -1]
    )
    sagittal = each(ct_slices()[:3], ImageOrientationPatient=[0, 1, 0, 0, 0, -1], SeriesNumber=7)
    report = each(ct_slices()[:1], SeriesNumber=9)
    del report[0].ImagePositionPatient, report[0].ImageOrientationPatient, report[0].PixelSpacing, report[0].Rows
    for name, series in (("a_scout", scout), ("b_sagittal", sagittal), ("c_report", report)):
        for number, one in enumerate(series):
            one.save_as(folder / f"{name}{number}.dcm", enforce_file_format=True)
    assert_object(folder)
    assert notes() == [
        "not used: a_scout0.dcm: ImageType is LOCALIZER",
        "not used: 3 files, the first of them b_sagittal0.dcm: another series (series 7 of 3 slices, 3 mm), not a "
        "stack of axial slices",
        "not used: c_report0.dcm: another series (series 9 of 1 slice, 3 mm), not a stack of axial slices",
    ]


def test_several_series_are_listed_with_their_differences(slices, tmp_path):
    folder = tmp_path / "series"
    write_series(each(slices, ConvolutionKernel=["Br38f", "3"], SeriesDescription="Doe"), folder)
    for number, one in enumerate(each(ct_slices()[:9], ConvolutionKernel="Br59d", SeriesNumber=2, SliceThickness=1)):
        one.save_as(folder / f"sharp{number}", enforce_file_format=True)
    refused(
        folder,
        "holds more than one DICOM series: series 1 of 14 slices, kernel Br38f/3, 3 mm (001.dcm); "
        + "series 2 of 9 slices, kernel Br59d, 1 mm (sharp0); "
        + "copy or link the files of one series into a new folder and give that",
    )


@pytest.mark.parametrize("number", [0, 6, 13])
def test_one_slice_with_another_series_uid_is_rejected(number, slices, tmp_path):
    slices[number].SeriesInstanceUID = "1.2.3"
    refused(write_series(slices, tmp_path / "series"), "which continues the series of")


def test_copies_are_skipped_and_other_slices_at_one_position_rejected(slices, tmp_path, notes):
    folder = tmp_path / "series"
    write_series(slices, folder)
    (folder / "copy.dcm").write_bytes((folder / "003.dcm").read_bytes())
    (folder / "zcopy").write_bytes((folder / "007.dcm").read_bytes())
    assert_object(folder)
    assert notes() == ["not used: 2 files, the first of them zcopy: a copy of another slice"]
    slices[3].PixelData, slices[3].AcquisitionNumber = slices[0].PixelData[:-2] + b"\0\1", 2
    slices[3].save_as(folder / "other.dcm", enforce_file_format=True)
    refused(folder, "two slices at z = 289.5 mm, 011.dcm and other.dcm")


def test_subfolder_with_the_series_is_named(slices, tmp_path):
    (tmp_path / "patient").mkdir()
    write_series(slices, tmp_path / "patient" / "series")
    refused(tmp_path / "patient", f"folders below have DICOM files, give one: {tmp_path}/patient/series")


# ---- values --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        *(({"RescaleType": unit}, f"RescaleType is {unit}, not HU") for unit in ("MGML", "HU_MOD", "Z_EFF", "ED")),
        (
            {"ImageType": ["DERIVED", "SECONDARY", "AXIAL", "MAT_SPECIFIC"]},
            "ImageType is MAT_SPECIFIC, not an image in HU",
        ),
        ({"ImageType": ["DERIVED", "SECONDARY", "MIP"]}, "ImageType is MIP, not an image in HU"),
        ({"ImageType": ["DERIVED", "SECONDARY", "PROJECTION IMAGE"]}, "ImageType is PROJECTION_IMAGE, not an image"),
        ({"SOPClassUID": EnhancedCTImageStorage}, "Enhanced CT Image Storage, multi-frame; convert it to one file per"),
        ({"NumberOfFrames": 14}, "multi-frame (14 frames)"),
        ({"BitsAllocated": 8}, "BitsAllocated is 8: a screen capture or a display window"),
        ({"SamplesPerPixel": 3}, "three samples per pixel"),
        (
            {"RescaleSlope": 0},
            "RescaleSlope is 0, so all values of 12 bits lie within 0 HU, less than from air to water",
        ),
        ({"RescaleSlope": "1e-30"}, "RescaleSlope is 1e-30, so all values of 12 bits lie within"),
        ({"PixelRepresentation": 7}, "PixelRepresentation is 7; it must be 0 or 1"),
        ({"BitsStored": 10, "HighBit": 9}, "has values beyond its 10 bits stored"),
        ({"HighBit": 15}, "BitsStored 12 and HighBit 15 do not fit BitsAllocated 16"),
        ({"RescaleSlope": 40}, "which no CT has; is PixelRepresentation (signed or not) or RescaleSlope wrong?"),
        (
            {"Rows": 24},
            "its header says 24 x 48 pixels, which the file does not hold (3840 bytes of PixelData, 2304 are",
        ),
        ({"Rows": 60}, "its header says 60 x 48 pixels, which the file does not hold"),
    ],
)
def test_values_other_than_hu_are_rejected(attributes, message, slices, tmp_path):
    refused(write_series(each(slices, **attributes), tmp_path / "series"), message)


def test_lookup_tables_and_other_real_world_values_are_rejected(slices, tmp_path):
    table = pydicom.Dataset()
    table.LUTDescriptor, table.LUTData = [4, 0, 16], b"\0\0\1\0\2\0\3\0"
    refused(write_series(each(slices, ModalityLUTSequence=[table]), tmp_path / "a"), "has a ModalityLUTSequence")
    for name, unit, slope in (("b", "mg/cm3", 1), ("c", "[hnsf'U]", 2), ("d", "[hnsf'U]", 1)):
        mapping, code = pydicom.Dataset(), pydicom.Dataset()
        code.CodeValue, mapping.MeasurementUnitsCodeSequence = unit, [code]
        mapping.RealWorldValueSlope, mapping.RealWorldValueIntercept = float(slope), -1024.0
        some = each(ct_slices(), RealWorldValueMappingSequence=[mapping])
        folder = write_series(some, tmp_path / name)
        if name == "d":
            assert_object(folder)
        else:
            refused(folder, {"b": "gives another unit than HU", "c": "and RescaleSlope disagree on HU"}[name])


@pytest.mark.parametrize("representation", [0, 1])
def test_padding_with_the_value_of_tissue_is_air_outside_the_body_only(representation, slices, tmp_path, notes):
    """The scanner's field of view is a circle with 0 HU outside; the same value within the body is tissue."""
    value = 1024 if representation == 0 else 0
    for one in slices:
        pixels = np.frombuffer(one.PixelData, "<u2").reshape(40, 48).astype(int)
        pixels[:3], pixels[:, -2:] = 1024, 1024
        one.PixelRepresentation, one.BitsStored, one.HighBit = representation, 16, 15
        one.RescaleIntercept = -value
        one.PixelData = (pixels - 1024 + value).astype("<i2").tobytes()
        one.add_new("PixelPaddingValue", "US", value)
    assert_object(write_series(slices, tmp_path / "series"))
    assert notes() == [
        f"{14 * (3 * 48 + 37 * 2)} voxels at the border of the slices have PixelPaddingValue, which would be tissue in "
        "HU; they are read as air"
    ]


def test_unsigned_padding_of_minus_2000_is_air(slices, tmp_path):
    for one in slices:
        pixels = np.frombuffer(one.PixelData, "<u2").reshape(40, 48).copy()
        pixels[:2] = 63536
        one.PixelData = pixels.tobytes()
        one.add_new("PixelPaddingValue", "SS", -2000)
    assert_object(write_series(slices, tmp_path / "series"))


def test_overlay_in_unused_bits_is_ignored(slices, tmp_path):
    for one in slices:
        pixels = np.frombuffer(one.PixelData, "<u2").copy()
        pixels[::7] |= 1 << 12
        one.PixelData = pixels.tobytes()
    refused(write_series(slices, tmp_path / "a"), "has values beyond its 12 bits stored")
    for one in slices:
        one.add_new(0x60000102, "US", 12)
    assert_object(write_series(slices, tmp_path / "b"))


def test_lossy_compression_and_reformatting_are_noted(slices, tmp_path, notes):
    each(slices, LossyImageCompression="01", ImageType=["DERIVED", "SECONDARY", "REFORMATTED", "AVERAGE"])
    assert_object(write_series(slices, tmp_path / "series"))
    assert notes() == [
        "LossyImageCompression is 01 in 14 of 14 slices: values were changed by lossy compression",
        "ImageType is AVERAGE: a reformatted image, whose noise is not the scanner's",
        "ImageType is REFORMATTED: a reformatted image, whose noise is not the scanner's",
    ]


# ---- geometry ------------------------------------------------------------------------------------


def rotated(slices, degrees):
    """Slices of a patient rotated about x: rows along x, columns and stack rotated together around the center."""
    turn = np.radians(degrees)
    across, along = np.array([0, np.cos(turn), np.sin(turn)]), np.array([0, -np.sin(turn), np.cos(turn)])
    for k, one in enumerate(slices):
        x = float(one.ImagePositionPatient[0])
        middle = np.array([0, 40.0, 300.0])
        position = middle - across * 39 + along * 3 * (k - 6.5)
        one.ImagePositionPatient = [x, round(position[1], 4), round(position[2], 4)]
        one.ImageOrientationPatient = [1, 0, 0, 0, round(across[1], 6), round(across[2], 6)]
    return slices


@pytest.mark.parametrize(
    "change",
    [
        lambda k, one: setattr(one, "PixelSpacing", [2.000001, 2 - 1e-6 * k]),
        lambda k, one: setattr(one, "InstanceNumber", 100 - k),
        lambda k, one: setattr(one, "GantryDetectorTilt", 0.01),
        lambda k, one: setattr(one, "ImageOrientationPatient", [1, 1e-5 * k, 0, 0, 1, 0]),
        lambda k, one: setattr(
            one, "ImagePositionPatient", [round(v + 0.004 * (k % 2), 3) for v in one.ImagePositionPatient]
        ),
    ],
)
def test_rounded_numbers_make_no_difference(change, slices, tmp_path, notes):
    for k, one in enumerate(slices):
        change(k, one)
    assert_object(write_series(slices, tmp_path / "series"))
    assert not notes()


def test_tilt_is_ignored_if_it_moves_voxels_by_less_than_a_half(slices, tmp_path, notes):
    """Slices of 80 mm: 0.5 degrees move the farthest voxel by 0.34 mm of 3 mm along z, 3 degrees by 2.0 mm."""
    assert_object(write_series(rotated(slices, 0.5), tmp_path / "a"))
    (line,) = notes()
    expected = 39 * np.sin(np.radians(0.5))
    words = "the volume is slightly rotated; reading it as upright moves voxels by at most"
    assert line == f"{words} {expected:.2g} mm"
    refused(write_series(rotated(ct_slices(), 3), tmp_path / "b"), "slices are tilted or not axial")
    assert_object(write_series(each(ct_slices(), GantryDetectorTilt=0.3), tmp_path / "c"))
    refused(write_series(each(ct_slices(), GantryDetectorTilt=3), tmp_path / "d"), "slices are tilted or not axial")


def test_rotated_volume_is_read_although_voxels_move_farther(slices, tmp_path, notes):
    """Pixels of 0.2 mm: 0.9 degrees move the stack's ends by 1.5 pixels. A shear of the same size is rejected."""
    fine = {"PixelSpacing": [0.2, 0.2]}
    volume = read_series(write_series(each(rotated(slices, 0.9), **fine), tmp_path / "a"))
    assert np.array_equal(volume.array, read_series(write_series(each(ct_slices(), **fine), tmp_path / "b")).array)
    (line,) = notes()
    assert line.startswith("the volume is slightly rotated; reading it as upright moves voxels by at most")
    sheared = each(rotated(ct_slices(), 0.9), ImageOrientationPatient=[1, 0, 0, 0, 1, 0], **fine)
    refused(write_series(sheared, tmp_path / "c"), "slices are shifted sideways against each other (gantry tilt)")
    refused(write_series(each(rotated(ct_slices(), 1.2), **fine), tmp_path / "d"), "resample the series onto upright")


def test_sagittal_and_coronal_series_are_named(slices, tmp_path):
    for name, cosines in (("a", [0, 1, 0, 0, 0, -1]), ("b", [1, 0, 0, 0, 0, -1])):
        refused(write_series(each(slices, ImageOrientationPatient=cosines), tmp_path / name), "tilted or not axial")


@pytest.mark.parametrize(
    "keyword",
    "ImagePositionPatient ImageOrientationPatient PixelSpacing Rows Columns SamplesPerPixel BitsAllocated BitsStored "
    "HighBit PixelRepresentation PhotometricInterpretation RescaleSlope RescaleIntercept PixelData".split(),
)
def test_a_missing_attribute_is_named(keyword, slices, tmp_path):
    for one in slices:
        one["PixelData"].VR = "OW"
    delattr(slices[5], keyword)
    refused(write_series(slices, tmp_path / "series"), f"009.dcm: has no {keyword}")


@pytest.mark.parametrize(
    ("keyword", "value", "message"),
    [
        ("PixelSpacing", b"2,0\\2,0 ", "PixelSpacing (2,0\\2,0) is not 2 finite numbers"),
        ("PixelSpacing", b"-2\\-2 ", "PixelSpacing (-2\\-2) is not positive"),
        ("RescaleSlope", b"1\\2 ", "RescaleSlope (1\\2) is not a finite number"),
        ("RescaleIntercept", b"1e999 ", "RescaleIntercept (1e999) is not a finite number"),
        ("ImagePositionPatient", b"1\\2 ", "ImagePositionPatient (1\\2) is not 3 finite numbers"),
        ("ImageOrientationPatient", b"Doe^Jane", "ImageOrientationPatient is not 6 finite numbers"),
        ("GantryDetectorTilt", b"none", "GantryDetectorTilt is not a finite number"),
    ],
)
def test_wrong_attribute_is_named_with_its_numbers_only(keyword, value, message, slices, tmp_path):
    tag = pydicom.tag.Tag(keyword)
    slices[5][tag] = pydicom.dataelem.RawDataElement(tag, "DS", len(value), value, 0, False, True)
    refused(write_series(slices, tmp_path / "series"), f"009.dcm: {message}")


def test_rows_written_as_text_are_read(slices, tmp_path):
    for one in slices:
        del one.Rows
        one.add_new("Rows", "LO", "40")
    folder = tmp_path / "series"
    folder.mkdir()
    for number, one in enumerate(slices):
        one.save_as(folder / f"{number}.dcm")
    assert_object(folder)


def test_slices_of_two_frames_of_reference_are_rejected(slices, tmp_path):
    slices[4].FrameOfReferenceUID = "1.2.3"
    refused(write_series(slices, tmp_path / "series"), "FrameOfReferenceUID differs from the other slices'")
