"""RT Structure Sets of any contours, written with pydicom only."""

import numpy as np
import phantom_files
import pydicom
from pydicom.uid import ExplicitVRLittleEndian, RTStructureSetStorage, generate_uid

GRID = phantom_files.CT_GRID  # 14 x 40 x 48 voxels of 3 x 2 x 2 mm
Z = phantom_files.CENTRE[2] + GRID.axes_mm()[0]


def circle(radius, z, x=0.0, y=0.0, points=256, turn=0.0):
    """A circle around the CT's center, LPS mm; x and y in the NIfTI world."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False) + turn
    x0, y0, _ = phantom_files.CENTRE
    return np.column_stack(
        [-(x0 + x + radius * np.cos(angle)), -(y0 + y + radius * np.sin(angle)), np.full(points, float(z))]
    )


def disc(radius, x=0.0, y=0.0):
    """Voxels of a slice within a circle, by their distance from its center."""
    _, yy, xx = GRID.axes_mm()
    return np.hypot(yy[:, None] - y, xx[None] - x) < radius


def contour(points, kind="CLOSED_PLANAR", **changed):
    """Item of ContourSequence; attributes that are None are omitted."""
    item = pydicom.Dataset()
    points = np.asarray(points, float)
    values = {"ContourGeometricType": kind, "NumberOfContourPoints": len(points)}
    values |= {"ContourData": [f"{value:.3f}" for value in points.ravel()], **changed}
    for keyword, value in values.items():
        if value is not None:
            setattr(item, keyword, value)
    return item


def structure_set(*rois, path="rt.dcm", charset=None):
    """Write (number, name, contours) each; names and contours that are None are omitted."""
    ds = pydicom.Dataset()
    ds.file_meta = pydicom.dataset.FileMetaDataset()
    ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = RTStructureSetStorage
    ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID = generate_uid()
    ds.Modality = "RTSTRUCT"
    if charset:
        ds.SpecificCharacterSet = charset
    ds.StructureSetROISequence, ds.ROIContourSequence = [], []
    for number, name, contours in rois:
        if name is not None:
            roi = pydicom.Dataset()
            roi.ROINumber, roi.ROIName = number, name
            ds.StructureSetROISequence.append(roi)
        if contours is not None:
            item = pydicom.Dataset()
            item.ReferencedROINumber, item.ContourSequence = number, contours
            ds.ROIContourSequence.append(item)
    ds.save_as(path, enforce_file_format=True)
    return str(path)
