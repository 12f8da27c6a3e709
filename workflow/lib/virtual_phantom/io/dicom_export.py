"""Simulated images as DICOM CT series, and their ROIs as DICOM SEG, for programs that read nothing else.

CT Image IOD (PS3.3, A.3) with its mandatory modules. DICOM's patient frame is LPS: rows run to the patient's left,
columns to posterior, slices to superior, so that both in-plane axes of a volume are flipped. There is no patient:
names say what was simulated, dates are empty, and UIDs are hashes of the content, so that equal images make equal
files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from .. import __version__
from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import whole_hu
from .files import replacing
from .volumes import Volume

NAME = "Virtual Phantom"
DECIMALS = 5  # of mm: NIfTI keeps single precision, whose last digits mean nothing
TEXT_LENGTH = 64  # of a DICOM long string


@dataclass(frozen=True)
class Scan:
    """What a series is called, and what is known of how it was acquired.

    Attributes
    ----------
    label : str
        Protocol, noise level and seed.
    description : str
        One line for whoever opens it.
    source_to_isocentre_mm, source_to_detector_mm : float
        Of the scanner, mm.
    """

    protocol: str
    label: str
    description: str
    source_to_isocentre_mm: float
    source_to_detector_mm: float


def series(image: Volume, phantom: Volume, scan: Scan) -> list[Dataset]:
    """One dataset per slice, from inferior to superior; whole HU, rescaled by slope 1 and intercept 0.

    Parameters
    ----------
    image : Volume
        HU on the phantom's grid; fractions are rounded.
    phantom : Volume
        What was scanned: its series make one study, in one frame of reference.

    Raises
    ------
    InputError
        If the image is on another grid, or holds values that are not finite or beyond 16 bits.
    """
    if not image.grid.matches(phantom.grid):
        raise InputError(f"{scan.label}: is on another grid ({image.grid}) than the phantom ({phantom.grid})")
    values, beyond = whole_hu(image.array, f"{scan.label}: holds values that are not finite; reconstruct it again")
    if beyond:
        raise InputError(f"{scan.label}: holds CT numbers beyond 16 bits, which DICOM CT images have")
    pixels = lps(values)
    study, image_hash = _content(phantom), _content(image)
    shared = _shared(image.grid, scan, study, image_hash)
    slices = []
    for index, (plane, position) in enumerate(zip(pixels, positions_lps(image.grid), strict=True)):
        one = Dataset()
        one.update(shared)
        one.SOPInstanceUID = uid(image_hash, scan.label, "slice", index)
        one.InstanceNumber = index + 1
        one.ImagePositionPatient = position
        one.SliceLocation = position[2]
        one.PixelData = np.ascontiguousarray(plane, dtype="<i2").tobytes()
        one["PixelData"].VR = "OW"
        one.file_meta = FileMetaDataset()
        one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID
        one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID
        slices.append(one)
    return slices


def segmentation(slices: Sequence[Dataset], masks: Mapping[str, np.ndarray]) -> Dataset:
    """The ROIs as one DICOM SEG, a segment each, of these slices.

    Content date and time are those of writing: DICOM wants some.

    Parameters
    ----------
    slices : sequence of Dataset
        The image's, as `series` makes them.
    masks : mapping of str to ndarray of bool, shape (z, y, x)
        ROIs by name, on the grid of the image.
    """
    import highdicom  # a third of a second, for those who export
    from pydicom.sr.codedict import codes

    described = [
        highdicom.seg.SegmentDescription(
            number, name, codes.SCT.Tissue, codes.SCT.Tissue, highdicom.seg.SegmentAlgorithmTypeValues.MANUAL
        )
        for number, name in enumerate(masks, start=1)
    ]
    series_uid = slices[0].SeriesInstanceUID
    stacked = np.stack([lps(mask) for mask in masks.values()], axis=-1).astype(np.uint8)
    content = hashlib.sha256(stacked.tobytes()).hexdigest()
    return highdicom.seg.Segmentation(
        source_images=list(slices),
        pixel_array=stacked,
        segmentation_type=highdicom.seg.SegmentationTypeValues.BINARY,
        segment_descriptions=described,
        series_instance_uid=uid(series_uid, content, "rois series"),
        series_number=2,
        sop_instance_uid=uid(series_uid, content, "rois"),
        instance_number=1,
        manufacturer=NAME,
        manufacturer_model_name="simulation",
        software_versions=__version__,
        device_serial_number="none",
        series_description=f"regions of interest of {slices[0].SeriesDescription}"[:TEXT_LENGTH],
        omit_empty_frames=True,
    )


def write(dataset: Dataset, path: str | Path) -> None:
    """Write one DICOM file."""
    with replacing(path, checksum=False) as temporary:  # other programs take every file in the folder for a slice
        dataset.save_as(temporary, enforce_file_format=True)


def write_series(slices: Iterable[Dataset], folder: str | Path) -> None:
    """Write 001.dcm, 002.dcm, ... from inferior to superior."""
    for one in slices:
        write(one, Path(folder) / f"{one.InstanceNumber:03d}.dcm")


def lps(array: np.ndarray) -> np.ndarray:
    """[z, y, x] along the NIfTI world's positive axes as DICOM slices: rows to the left, columns to posterior."""
    return array[:, ::-1, ::-1]


def positions_lps(grid: Grid) -> list[list[float]]:
    """Where the first pixel of each slice lies, mm (x, y, z) in DICOM's patient frame."""
    z, y, x = (axis + centre for axis, centre in zip(grid.axes_mm(), grid.centre_mm[::-1], strict=True))
    return [[_mm(-x[-1]), _mm(-y[-1]), _mm(height)] for height in z]


def uid(*sources: object) -> str:
    """A UID that depends on these alone."""
    return generate_uid(entropy_srcs=["virtual_phantom", *map(str, sources)])


def _shared(grid: Grid, scan: Scan, study: str, image_hash: str) -> Dataset:
    """What all slices of a series hold, module by module."""
    dz, dy, dx = map(_mm, grid.spacing)
    ds = Dataset()
    # Patient: nobody
    ds.PatientName, ds.PatientID, ds.PatientBirthDate, ds.PatientSex = (
        "Virtual^Phantom",
        f"phantom-{study[:12]}",
        "",
        "",
    )
    ds.QualityControlSubject = "YES"
    ds.PatientComments = "Simulated: a phantom, not a patient"
    # General study
    ds.StudyInstanceUID, ds.StudyDate, ds.StudyTime = uid(study, "study"), "", ""
    ds.StudyID, ds.AccessionNumber, ds.ReferringPhysicianName = study[:12], "", ""
    ds.StudyDescription = f"{NAME}, simulated CT"
    # General series, equipment, frame of reference
    ds.Modality, ds.SeriesNumber, ds.PatientPosition = "CT", 1, "HFS"
    ds.SeriesInstanceUID = uid(image_hash, scan.label, "series")
    ds.SeriesDescription, ds.ProtocolName = scan.label[:TEXT_LENGTH], scan.protocol[:TEXT_LENGTH]
    ds.Manufacturer, ds.ManufacturerModelName, ds.SoftwareVersions = NAME, "simulation", __version__
    ds.FrameOfReferenceUID, ds.PositionReferenceIndicator = uid(study, "frame of reference"), ""
    # General image, plane, pixels
    ds.SOPClassUID, ds.ImageType = CTImageStorage, ["ORIGINAL", "PRIMARY", "AXIAL"]
    ds.AcquisitionNumber, ds.BurnedInAnnotation = 1, "NO"
    ds.ImageComments = f"Simulated. {scan.description}"
    ds.PixelSpacing, ds.ImageOrientationPatient = [dy, dx], [1, 0, 0, 0, 1, 0]
    ds.SliceThickness, ds.SpacingBetweenSlices = dz, dz
    ds.SamplesPerPixel, ds.PhotometricInterpretation = 1, "MONOCHROME2"
    ds.Rows, ds.Columns = grid.shape[1:]
    ds.BitsAllocated, ds.BitsStored, ds.HighBit, ds.PixelRepresentation = 16, 16, 15, 1
    # CT: the abdominal window to begin with
    ds.RescaleIntercept, ds.RescaleSlope, ds.RescaleType, ds.KVP = 0, 1, "HU", None
    ds.WindowCenter, ds.WindowWidth = 40, 400
    ds.DistanceSourceToPatient = _mm(scan.source_to_isocentre_mm)
    ds.DistanceSourceToDetector = _mm(scan.source_to_detector_mm)
    return ds


def _content(volume: Volume) -> str:
    """A hash of the voxels and of where they are."""
    digest = hashlib.sha256(np.ascontiguousarray(volume.array).tobytes())
    digest.update(np.round(volume.grid.affine, DECIMALS).tobytes())
    return digest.hexdigest()


def _mm(value: float) -> float:
    return round(float(value), DECIMALS) + 0.0  # not -0
