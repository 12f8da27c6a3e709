"""Export of simulated images as DICOM CT series, and of their ROIs as DICOM SEG.

Series have the mandatory modules of the CT Image IOD (PS3.3, A.3). DICOM's patient frame is LPS: rows run to the
patient's left, columns to posterior, slices to superior, so both in-plane axes of a volume are flipped. There is no
patient: names describe the simulation, dates are empty, and UIDs are hashes of the content, so equal images give equal
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
from ..base.units import rounded_hu
from .files import replacing
from .volumes import Volume

NAME = "Virtual Phantom"
DECIMALS = 5  # of mm; later digits are rounding errors of NIfTI's single precision
TEXT_LENGTH = 64  # of a DICOM long string (LO)


@dataclass(frozen=True)
class Scan:
    """Name of a series and its acquisition.

    Attributes
    ----------
    label : str
        Protocol, noise level and seed.
    description : str
        One line of explanation.
    """

    protocol: str
    label: str
    description: str
    source_to_isocentre_mm: float
    source_to_detector_mm: float


def series(image: Volume, phantom: Volume, scan: Scan) -> list[Dataset]:
    """Return one dataset per slice, from inferior to superior: integer HU, with rescale slope 1 and intercept 0.

    Parameters
    ----------
    image : Volume
        HU on the phantom's grid; fractions are rounded.
    phantom : Volume
        The scanned phantom; its series form one study, in one frame of reference.

    Raises
    ------
    InputError
        If the image has another grid, or values that are not finite or beyond 16 bits.
    """
    if not image.grid.matches(phantom.grid):
        raise InputError(f"{scan.label}: is on another grid ({image.grid}) than the phantom ({phantom.grid})")
    values, beyond = rounded_hu(image.array, f"{scan.label}: holds values that are not finite; reconstruct it again")
    if beyond:
        raise InputError(f"{scan.label}: holds CT numbers beyond 16 bits, which DICOM CT images have")
    pixels = lps(values)
    study, image_hash = _content(phantom), _content(image)
    shared = _shared(image.grid, scan, study, image_hash)
    slices = []
    for index, (plane, position) in enumerate(zip(pixels, positions_lps(image.grid), strict=True)):
        dataset = ct_image(shared, index + 1, uid(image_hash, scan.label, "slice", index), plane.astype("<i2"))
        dataset.ImagePositionPatient, dataset.SliceLocation = position, position[2]
        slices.append(dataset)
    return slices


def simulated_ct(study: str, patient: str, series_uid: str) -> Dataset:
    """Return the elements of all simulated CT data: anonymous, with 16-bit pixels; `study` is a hash of the content."""
    ds = Dataset()
    ds.SOPClassUID, ds.Modality, ds.ImageType = CTImageStorage, "CT", ["ORIGINAL", "PRIMARY", "AXIAL"]
    ds.PatientName, ds.PatientID, ds.PatientBirthDate, ds.PatientSex = "Virtual^Phantom", patient, "", ""
    ds.StudyInstanceUID, ds.SeriesInstanceUID, ds.SeriesNumber = uid(study, "study"), series_uid, 1
    ds.StudyDate, ds.StudyTime, ds.StudyID, ds.AccessionNumber, ds.ReferringPhysicianName = "", "", "", "", ""
    ds.Manufacturer, ds.ManufacturerModelName, ds.SoftwareVersions = NAME, "simulation", __version__
    ds.SamplesPerPixel, ds.PhotometricInterpretation = 1, "MONOCHROME2"
    ds.BitsAllocated, ds.BitsStored, ds.HighBit, ds.KVP = 16, 16, 15, None
    return ds


def ct_image(shared: Dataset, number: int, instance_uid: str, pixels: np.ndarray) -> Dataset:
    """Return the dataset of one CT file: the elements that a series shares, and 16-bit pixels (little-endian)."""
    dataset = Dataset()
    dataset.update(shared)
    dataset.InstanceNumber, dataset.SOPInstanceUID = number, instance_uid
    dataset.PixelData = np.ascontiguousarray(pixels).tobytes()
    dataset["PixelData"].VR = "OW"
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID
    return dataset


def segmentation(slices: Sequence[Dataset], masks: Mapping[str, np.ndarray]) -> Dataset:
    """Return ROIs as one DICOM SEG of these slices, with one segment per mask [z, y, x] on the grid of the image.

    Content date and time, which DICOM requires, are the time of the call.
    """
    import highdicom  # takes 0.3 s to import
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
    with replacing(path, checksum=False) as temporary:  # other programs read every file in the folder as a slice
        dataset.save_as(temporary, enforce_file_format=True)


def write_series(slices: Iterable[Dataset], folder: str | Path) -> None:
    """Write 001.dcm, 002.dcm, ... from inferior to superior."""
    for dataset in slices:
        write(dataset, Path(folder) / f"{dataset.InstanceNumber:03d}.dcm")


def lps(array: np.ndarray) -> np.ndarray:
    """Convert [z, y, x] in the NIfTI world to DICOM slices, with rows to the left and columns to posterior."""
    return array[:, ::-1, ::-1]


def positions_lps(grid: Grid) -> list[list[float]]:
    """Return the position of the first pixel of each slice, mm (x, y, z) in DICOM's patient frame."""
    z, y, x = (axis + centre for axis, centre in zip(grid.axes_mm(), grid.centre_mm[::-1], strict=True))
    return [[_mm(-x[-1]), _mm(-y[-1]), _mm(height)] for height in z]


def uid(*sources: object) -> str:
    """Return a UID that depends only on these words."""
    return generate_uid(entropy_srcs=["virtual_phantom", *map(str, sources)])


def _shared(grid: Grid, scan: Scan, study: str, image_hash: str) -> Dataset:
    """Return the elements that all slices share, module by module."""
    dz, dy, dx = map(_mm, grid.spacing)
    ds = simulated_ct(study, f"phantom-{study[:12]}", uid(image_hash, scan.label, "series"))
    # Patient and study
    ds.QualityControlSubject, ds.StudyID = "YES", study[:12]
    ds.PatientComments = "Simulated: a phantom, not a patient"
    ds.StudyDescription = f"{NAME}, simulated CT"
    # General series, frame of reference
    ds.PatientPosition = "HFS"
    ds.SeriesDescription, ds.ProtocolName = scan.label[:TEXT_LENGTH], scan.protocol[:TEXT_LENGTH]
    ds.FrameOfReferenceUID, ds.PositionReferenceIndicator = uid(study, "frame of reference"), ""
    # General image, plane, pixels
    ds.AcquisitionNumber, ds.BurnedInAnnotation = 1, "NO"
    ds.ImageComments = f"Simulated. {scan.description}"
    ds.PixelSpacing, ds.ImageOrientationPatient = [dy, dx], [1, 0, 0, 0, 1, 0]
    ds.SliceThickness, ds.SpacingBetweenSlices = dz, dz
    ds.Rows, ds.Columns = grid.shape[1:]
    ds.PixelRepresentation = 1
    # CT, with an abdominal window
    ds.RescaleIntercept, ds.RescaleSlope, ds.RescaleType = 0, 1, "HU"
    ds.WindowCenter, ds.WindowWidth = 40, 400
    ds.DistanceSourceToPatient = _mm(scan.source_to_isocentre_mm)
    ds.DistanceSourceToDetector = _mm(scan.source_to_detector_mm)
    return ds


def _content(volume: Volume) -> str:
    """Return a hash of the voxels and their positions."""
    digest = hashlib.sha256(np.ascontiguousarray(volume.array).tobytes())
    digest.update(np.round(volume.grid.affine, DECIMALS).tobytes())
    return digest.hexdigest()


def _mm(value: float) -> float:
    return round(float(value), DECIMALS) + 0.0  # not -0
