"""A small CT of a known object, written as DICOM series, NIfTI, DICOM SEG and RTSTRUCT.

The object lies in the NIfTI world frame (mm, x right, y anterior, z superior) around `CENTRE`. It is a water cylinder
along z and two balls off all axes, so that a reversed or shifted axis changes it.
"""

import highdicom
import nibabel
import numpy as np
import pydicom
from pydicom.sr.codedict import codes
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, RTStructureSetStorage, generate_uid
from skimage.measure import find_contours

from virtual_phantom.base.geometry import Grid

CENTRE = (5.0, -40.0, 300.0)
CT_GRID = Grid((14, 40, 48), (3.0, 2.0, 2.0), CENTRE)
BALLS = {"bright": ((14, 8, 6), 9.0, 100.0), "dark": ((-16, -10, -6), 8.0, -60.0)}  # offset, radius (mm), HU


def ball(name: str, grid: Grid = CT_GRID) -> np.ndarray:
    (x0, y0, z0), radius, _ = BALLS[name]
    z, y, x = np.ix_(*grid.axes_mm())
    return (x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2 < radius**2


def object_hu() -> np.ndarray:
    """HU [z, y, x] along the positive axes of the NIfTI world frame."""
    z, y, x = np.ix_(*CT_GRID.axes_mm())
    hu = np.where((x / 40) ** 2 + (y / 32) ** 2 + 0 * z < 1, 0.0, -1000.0)
    for name, (_, _, value) in BALLS.items():
        hu[ball(name)] = value
    return hu.astype(np.float32)


def lps(array: np.ndarray) -> np.ndarray:
    """[z, y, x] of the world frame as DICOM slices, with rows to posterior and columns to the patient's left."""
    return array[:, ::-1, ::-1]


def first_pixel_lps(k: int) -> list[float]:
    """Position (mm, LPS) of the first pixel of slice k, counted from inferior."""
    z, y, x = CT_GRID.axes_mm()
    return [-(x[-1] + CENTRE[0]), -(y[-1] + CENTRE[1]), z[k] + CENTRE[2]]


def ct_slices() -> list[pydicom.Dataset]:
    """DICOM slices from inferior to superior."""
    study, series, frame = generate_uid(), generate_uid(), generate_uid()
    slices = []
    for k, pixels in enumerate(lps(object_hu())):
        ds = pydicom.Dataset()
        ds.file_meta = pydicom.dataset.FileMetaDataset()
        ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        ds.SOPClassUID, ds.SOPInstanceUID = CTImageStorage, generate_uid()
        ds.file_meta.MediaStorageSOPClassUID = ds.SOPClassUID
        ds.file_meta.MediaStorageSOPInstanceUID = ds.SOPInstanceUID
        ds.PatientID, ds.PatientName, ds.PatientBirthDate, ds.PatientSex = "1", "A^B", "", ""
        ds.StudyID, ds.StudyDate, ds.StudyTime, ds.AccessionNumber = "1", "20200101", "000000", ""
        ds.ReferringPhysicianName, ds.Manufacturer = "", ""
        ds.StudyInstanceUID, ds.SeriesInstanceUID, ds.FrameOfReferenceUID = study, series, frame
        ds.Modality, ds.SeriesNumber, ds.InstanceNumber = "CT", 1, k + 1
        ds.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        ds.PositionReferenceIndicator, ds.SliceThickness = "", 3
        ds.Rows, ds.Columns = pixels.shape
        ds.PixelSpacing, ds.ImageOrientationPatient = [2, 2], [1, 0, 0, 0, 1, 0]
        ds.ImagePositionPatient = first_pixel_lps(k)
        ds.SamplesPerPixel, ds.PhotometricInterpretation, ds.PixelRepresentation = 1, "MONOCHROME2", 0
        ds.BitsAllocated, ds.BitsStored, ds.HighBit = 16, 12, 11
        ds.RescaleSlope, ds.RescaleIntercept = 1, -1024
        ds.PixelData = (pixels + 1024).astype(np.uint16).tobytes()
        slices.append(ds)
    return slices


def write_series(slices: list[pydicom.Dataset], folder) -> str:
    """Write a series whose file names run against the slice order, which must come from the positions alone."""
    folder.mkdir(exist_ok=True)
    for k, ds in enumerate(slices):
        ds.save_as(folder / f"{len(slices) - k:03d}.dcm", enforce_file_format=True)
    return str(folder)


def write_nifti_array(array: np.ndarray, path, flip_y: bool = False, grid: Grid = CT_GRID) -> str:
    """Write [z, y, x] as NIfTI, optionally with rows stored from anterior to posterior."""
    affine = grid.affine
    data = array.T
    if flip_y:
        data = data[:, ::-1]
        affine = affine @ np.array([[1, 0, 0, 0], [0, -1, 0, data.shape[1] - 1], [0, 0, 1, 0], [0, 0, 0, 1]])
    nibabel.save(nibabel.Nifti1Image(data, affine), path)
    return str(path)


def segmentation(slices, path, array, kind="BINARY", names=tuple(BALLS), **more):
    """SEG by highdicom; array (slice, row, column, segment), or (slice, row, column) of a label map."""
    manual = highdicom.seg.SegmentAlgorithmTypeValues.MANUAL
    made = highdicom.seg.Segmentation(
        source_images=slices,
        pixel_array=array,
        segmentation_type=kind,
        segment_descriptions=[
            highdicom.seg.SegmentDescription(n, name, codes.SCT.Tissue, codes.SCT.Liver, manual)
            for n, name in enumerate(names, 1)
        ],
        series_instance_uid=generate_uid(),
        series_number=2,
        sop_instance_uid=generate_uid(),
        instance_number=1,
        manufacturer="none",
        manufacturer_model_name="none",
        software_versions="1",
        device_serial_number="1",
        **more,
    )
    made.save_as(path)
    return str(path)


def write_seg(slices: list[pydicom.Dataset], path) -> str:
    """Write two segments, the balls; empty frames are omitted, as usual."""
    masks = np.stack([lps(ball(name)) for name in BALLS], axis=-1).astype(np.uint8)
    return segmentation(slices, path, masks, omit_empty_frames=True)


def write_rtstruct(path, hole: bool = False, shift_z_mm: float = 0.0) -> str:
    """Write the balls' contours slice by slice; with `hole`, a hole of 3 x 3 voxels in each contour of `bright`."""
    ds = pydicom.Dataset()
    ds.file_meta = pydicom.dataset.FileMetaDataset()
    ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    ds.SOPClassUID, ds.SOPInstanceUID = RTStructureSetStorage, generate_uid()
    ds.file_meta.MediaStorageSOPClassUID, ds.file_meta.MediaStorageSOPInstanceUID = (
        ds.SOPClassUID,
        ds.SOPInstanceUID,
    )
    ds.Modality, ds.StructureSetROISequence, ds.ROIContourSequence = (
        "RTSTRUCT",
        pydicom.Sequence(),
        pydicom.Sequence(),
    )
    for number, name in enumerate([*BALLS, "nothing"], start=1):
        roi, contours = pydicom.Dataset(), pydicom.Dataset()
        roi.ROINumber, roi.ROIName = number, name
        contours.ReferencedROINumber, contours.ContourSequence = number, pydicom.Sequence()
        for k, mask in enumerate(lps(ball(name)) if name in BALLS else ()):
            for outline in find_contours(mask.astype(float), 0.5):
                outlines = [outline]
                if hole and name == "bright":
                    row, column = outline[:-1].mean(axis=0).round()
                    outlines.append(
                        np.array(
                            [[row + a, column + b] for a, b in ((-1.5, -1.5), (-1.5, 1.5), (1.5, 1.5), (1.5, -1.5))]
                        )
                    )
                for points in outlines:
                    contour = pydicom.Dataset()
                    x0, y0, z0 = first_pixel_lps(k)
                    world = [[x0 + 2 * c, y0 + 2 * r, z0 + shift_z_mm] for r, c in points]
                    contour.ContourGeometricType, contour.NumberOfContourPoints = "CLOSED_PLANAR", len(world)
                    contour.ContourData = [round(v, 3) for point in world for v in point]
                    contours.ContourSequence.append(contour)
        ds.StructureSetROISequence.append(roi)
        ds.ROIContourSequence.append(contours)
    ds.save_as(path, enforce_file_format=True)
    return str(path)
