"""Substitutes of public scans: DICOM with the identifiers, tags and file order of the real ones, and other contents.

Only the list of the real files is known (public_scans.csv). Tags of the CT are those that its scanner writes. The SEG
has the layout of pydicom-seg 0.4.1; test_public_seg.py writes one with that program.
"""

import csv
import uuid
from dataclasses import replace

import numpy as np
import pydicom
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, SegmentationStorage, generate_uid

from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.dicom_export import lps, positions_lps
from virtual_phantom.io.volumes import Volume
from virtual_phantom.recordings.public_scans.table import TABLE, public_scans

PATIENT = "SPHNQA4IQI"
# Names in the study's own programs (public repository QA4IQI/qa4iqi-extraction).
SEGMENTS = ("normal1", "normal2", "cyst1", "cyst2", "hemangioma", "metastasis")
GRID = Grid((6, 20, 24), (2.0, 4.0, 4.0), (3.0, -10.0, 800.0))


def listed(*names):
    """Scans of the shipped list."""
    return [next(scan for scan in public_scans() if scan.name == name) for name in names]


def some_image(seed=0):
    """A disc with noise."""
    z, y, x = np.ix_(*GRID.axes_mm())
    hu = np.where((x / 40) ** 2 + (y / 32) ** 2 + 0 * z < 1, 40.0, -1000.0)
    return Volume((hu + np.random.default_rng(seed).normal(0, 10, hu.shape)).astype(np.float32), GRID)


def some_masks():
    """Six blocks, of some slices only."""
    masks = {}
    for number, name in enumerate(SEGMENTS):
        masks[name] = np.zeros(GRID.shape, bool)
        masks[name][1 + number % 2 : 5, 6:12, 3 + 3 * number : 5 + 3 * number] = True
    return masks


def ct_slices(scan, image):
    """Slices of the CT in the order of their instance numbers: from superior to inferior."""
    pixels = lps(np.rint(image.array) + 1024).clip(0, 4095).astype(np.uint16)
    slices = []
    for number, (plane, position) in enumerate(
        zip(pixels[::-1], positions_lps(image.grid)[::-1], strict=True), start=1
    ):
        ds = _file(CTImageStorage)
        ds.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL", "CT_SOM5 SPI"]
        ds.PatientName = ds.PatientID = PATIENT
        ds.PatientBirthDate, ds.PatientSex, ds.StudyID, ds.AccessionNumber = "", "", "", ""
        ds.StudyDate = ds.SeriesDate = "20170221"
        ds.StudyTime, ds.ReferringPhysicianName = "", ""
        ds.StudyInstanceUID, ds.SeriesInstanceUID = scan.study, scan.ct.uid
        ds.FrameOfReferenceUID = generate_uid(entropy_srcs=["frame", scan.study])
        ds.SOPInstanceUID = generate_uid(entropy_srcs=[scan.ct.uid, str(number)])
        ds.file_meta.MediaStorageSOPInstanceUID = ds.SOPInstanceUID
        ds.Modality, ds.Manufacturer, ds.ManufacturerModelName = "CT", "SIEMENS", scan.model
        ds.StudyDescription = "Thorax^CTD_01_TH_ROUTINE_NEU (Adult)"
        ds.SeriesDescription, ds.SeriesNumber, ds.InstanceNumber = scan.description, _number(scan), number
        ds.AcquisitionNumber, ds.PatientPosition, ds.PositionReferenceIndicator = 1, "HFS", ""
        ds.KVP, ds.SliceThickness, ds.ConvolutionKernel = 120, scan.slice_mm, _kernel(scan)
        ds.SpiralPitchFactor, ds.ExposureTime, ds.GantryDetectorTilt = 1.0, 500, 0
        ds.Rows, ds.Columns = plane.shape
        ds.PixelSpacing, ds.ImageOrientationPatient = list(image.grid.spacing[1:]), [1, 0, 0, 0, 1, 0]
        ds.ImagePositionPatient, ds.SliceLocation = position, position[2]
        ds.SamplesPerPixel, ds.PhotometricInterpretation, ds.PixelRepresentation = 1, "MONOCHROME2", 0
        ds.BitsAllocated, ds.BitsStored, ds.HighBit = 16, 12, 11
        ds.RescaleSlope, ds.RescaleIntercept, ds.RescaleType = 1, -1024, "HU"
        ds.PixelData = plane.tobytes()
        ds["PixelData"].VR = "OW"
        slices.append(ds)
    return slices


def seg(scan, slices, masks):
    """SEG of the regions, {segment's label: bool [z, y, x]}."""
    first = slices[0]
    ds = _file(SegmentationStorage)
    ds.SOPInstanceUID = generate_uid(entropy_srcs=[scan.seg.uid])
    ds.file_meta.MediaStorageSOPInstanceUID = ds.SOPInstanceUID
    for name in ("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyID", "AccessionNumber"):
        setattr(ds, name, first.get(name))
    for name in ("StudyDate", "StudyTime", "ReferringPhysicianName", "StudyInstanceUID", "FrameOfReferenceUID"):
        setattr(ds, name, first.get(name))
    ds.PositionReferenceIndicator = ""
    ds.SeriesInstanceUID, ds.SeriesNumber, ds.Modality = scan.seg.uid, _number(scan), "SEG"
    ds.SeriesDescription = f"{scan.description} - SEG"
    ds.Manufacturer, ds.ManufacturerModelName = "pydicom-seg", "https://github.com/razorx89/pydicom-seg"
    ds.DeviceSerialNumber, ds.SoftwareVersions = "0", "0.4.1"
    ds.InstanceNumber, ds.ContentDate, ds.ContentTime = 1, "20191101", "000000"
    ds.ContentLabel, ds.ContentDescription, ds.ContentCreatorName = "SEGMENTATION", "", ""
    ds.ImageType = ["DERIVED", "PRIMARY"]
    ds.SegmentationType, ds.LossyImageCompression = "BINARY", "00"
    ds.Rows, ds.Columns = first.Rows, first.Columns
    ds.SamplesPerPixel, ds.PhotometricInterpretation, ds.PixelRepresentation = 1, "MONOCHROME2", 0
    ds.BitsAllocated, ds.BitsStored, ds.HighBit = 1, 1, 0
    ds.SegmentSequence = [_segment(number, name) for number, name in enumerate(masks, start=1)]
    organisation = generate_uid(entropy_srcs=[scan.seg.uid, "dimensions"])
    ds.DimensionOrganizationSequence = [_of(DimensionOrganizationUID=organisation)]
    ds.DimensionIndexSequence = [
        _of(DimensionOrganizationUID=organisation, DimensionIndexPointer=pointer, FunctionalGroupPointer=group)
        for pointer, group in ((0x0062000B, 0x0062000A), (0x00200032, 0x00209113))
    ]
    ds.SharedFunctionalGroupsSequence = [
        _of(
            PlaneOrientationSequence=[_of(ImageOrientationPatient=first.ImageOrientationPatient)],
            PixelMeasuresSequence=[
                _of(
                    PixelSpacing=first.PixelSpacing,
                    SliceThickness=first.SliceThickness,
                    SpacingBetweenSlices=abs(slices[1].ImagePositionPatient[2] - slices[0].ImagePositionPatient[2]),
                )
            ],
        )
    ]
    frames, groups = [], []
    for number, mask in enumerate(map(lps, masks.values()), start=1):
        for k, one in enumerate(slices[::-1]):  # from inferior
            if mask[k].any():
                frames.append(mask[k])
                groups.append(
                    _of(
                        FrameContentSequence=[_of(DimensionIndexValues=[number, k + 1])],
                        PlanePositionSequence=[_of(ImagePositionPatient=one.ImagePositionPatient)],
                        SegmentIdentificationSequence=[_of(ReferencedSegmentNumber=number)],
                        DerivationImageSequence=[],
                    )
                )
    ds.PerFrameFunctionalGroupsSequence, ds.NumberOfFrames = groups, len(frames)
    packed = np.packbits(np.stack(frames).ravel().astype(np.uint8), bitorder="little").tobytes()
    ds.PixelData = packed + b"\0" * (len(packed) % 2)
    ds["PixelData"].VR = "OB"
    return ds


def _file(sop_class):
    ds = pydicom.Dataset()
    ds.file_meta = pydicom.dataset.FileMetaDataset()
    ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = sop_class
    return ds


def _of(**values):
    item = pydicom.Dataset()
    for name, value in values.items():
        setattr(item, name, value)
    return item


def _segment(number, label):
    code = {"CodeValue": "85756007", "CodingSchemeDesignator": "SCT", "CodeMeaning": "Tissue"}
    return _of(
        SegmentNumber=number,
        SegmentLabel=label,
        SegmentAlgorithmType="MANUAL",
        SegmentedPropertyCategoryCodeSequence=[_of(**code)],
        SegmentedPropertyTypeCodeSequence=[_of(**code)],
    )


def _number(scan):
    return int(scan.name) if scan.name.isdigit() else 1


def _kernel(scan):
    """Kernel as the scanner writes it; iterative kernels have a strength too."""
    return [scan.kernel, scan.reconstruction[-1]] if scan.reconstruction.startswith("ADMIRE") else scan.kernel


def write_bucket(scans, bucket, image_of=lambda scan: some_image(int(scan.acquisition)), masks=None):
    """Write scans in the layout of the public bucket: a folder per series with meaningless file names.

    Returns the scans with the numbers and sizes of these files.
    """
    masks = masks or some_masks()
    written = []
    for scan in scans:
        slices = ct_slices(scan, image_of(scan))
        sizes = {}
        for series, datasets in ((scan.ct, slices), (scan.seg, [seg(scan, slices, masks)])):
            folder = bucket / series.folder
            folder.mkdir(parents=True)
            for dataset in datasets:
                name = uuid.uuid5(uuid.NAMESPACE_OID, dataset.SOPInstanceUID)
                dataset.save_as(folder / f"{name}.dcm", enforce_file_format=True)
            sizes[series.modality.lower()] = whole(series, folder)
        written.append(replace(scan, **sizes))
    return written


def whole(series, folder):
    """Series with the files of a folder."""
    files = list(folder.iterdir())
    return replace(series, files=len(files), megabytes=round(sum(file.stat().st_size for file in files) / 1e6, 2))


def write_table(scans, path):
    """Write a list in the library's format with these scans in their rows; other scans are unchanged."""
    with open(TABLE, newline="") as file:
        rows = list(csv.DictReader(file))
    known = {scan.name: scan for scan in scans}
    for row in rows:
        if scan := known.get(row["scan"]):
            row |= {"ct_files": scan.ct.files, "ct_mb": scan.ct.megabytes, "seg_mb": scan.seg.megabytes}
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def simulated(repeats, seed=2022):
    """Drawn phantom, and simulated images of it: (phantom, images, {segment: mask})."""
    import virtual_phantom as vp

    phantom = vp.draw_phantom((24, 80, 80), (4.0, 3.75, 3.75))
    detector = {"columns": 100, "rows": 30, "column_pitch_mm": 6.4, "row_pitch_mm": 6.4}
    scan = vp.scan(phantom, projections=150, noise_level=6.0e-6, repeats=repeats, seed=seed, **detector)
    names = ("normal_1", "normal_2", "cyst_1", "cyst_2", "hemangioma", "metastasis")
    masks = {roi.name: roi.mask for roi in phantom.rois}
    return phantom, vp.reconstruct(scan, "fbp"), dict(zip(SEGMENTS, (masks[name] for name in names), strict=True))
