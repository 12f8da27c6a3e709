"""Projections as DICOM-CT-PD, the format of public low-dose CT data: its elements, and files of them.

Every view is a file. Private elements say where the detector's focal centre and the focal spot are; pixels are line
integrals, rescaled. Element (row j, column i), counted from 1, lies on an arc of radius d about the focal centre at the
fan angle (i - X) w / d and at z + (Y - j) h: rows run along -z. The frame is that of base/geometry.py.

References
----------
B. Chen et al., Med. Phys. 42, 6964, 2015; T. R. Moen et al., Med. Phys. 48, 902, 2021.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian
from pydicom.valuerep import DSfloat

from .. import __version__
from ..base.errors import InputError
from ..base.geometry import OrbitGeometry
from ..base.vectors import FLAT
from .dicom_export import NAME, uid, write
from .exchange import read_counts, read_line_integrals

ROWS, COLUMNS = (0x7029, 0x1010), (0x7029, 0x1011)
WIDTH, HEIGHT = (0x7029, 0x1002), (0x7029, 0x1006)
SHAPE = (0x7029, 0x100B)
FOCAL_ANGLE, FOCAL_Z, FOCAL_RADIUS = ((0x7031, element) for element in (0x1001, 0x1002, 0x1003))
DISTANCE, CENTRAL = (0x7031, 0x1031), (0x7031, 0x1033)
SPOT_ANGLE, SPOT_Z, SPOT_RADIUS = ((0x7033, element) for element in (0x100B, 0x100C, 0x100D))
SPOT_MODE, VIEWS_PER_TURN = (0x7033, 0x100E), (0x7033, 0x1013)
SOURCES, PHOTONS = (0x7033, 0x1061), (0x7033, 0x1065)
TRAJECTORY, BEAM = (0x7037, 0x1009), (0x7037, 0x100A)
CORRECTIONS = {
    "beam_hardening": (0x7039, 0x1003),
    "gain": (0x7039, 0x1004),
    "dark": (0x7039, 0x1005),
    "flat": (0x7039, 0x1006),
    "bad_pixels": (0x7039, 0x1007),
    "scatter": (0x7039, 0x1008),
}
LOGARITHM = (0x7039, 0x1009)
FLOATS = (
    WIDTH,
    HEIGHT,
    FOCAL_ANGLE,
    FOCAL_Z,
    FOCAL_RADIUS,
    DISTANCE,
    CENTRAL,
    SPOT_ANGLE,
    SPOT_Z,
    SPOT_RADIUS,
    PHOTONS,
)
WHOLE = (ROWS, COLUMNS, VIEWS_PER_TURN, SOURCES)
CREATORS = {
    0x7029: "Detector System Arrangement Module",
    0x7031: "Detector Dynamics Module",
    0x7033: "Source Dynamics Module",
    0x7037: "Projection Data Definitions",
    0x7039: "Preprocessing Flags Module",
}
GREATEST = 65535  # of a pixel
LEAST_COUNT = 0.5  # photons that a pixel without any is read as, as in the default study
MODES = {(False, False): "FFSNONE", (True, False): "FFSXY", (False, True): "FFSZ", (True, True): "FFSXYZ"}


def export_projections(path: str | Path, folder: str | Path) -> int:
    """Write projections of a study (projections/.../*.h5) as DICOM-CT-PD, one file per view.

    Parameters
    ----------
    path : str or Path
        Line integrals, or counts, of which they are made.
    folder : str or Path
        Is made.

    Returns
    -------
    int
        How many files were written.

    Raises
    ------
    InputError
        If the file is none of these, the folder is there already, or the detector is an arc about another point.
    """
    folder = Path(folder)
    if folder.exists():
        raise InputError(f"{folder}: is there already; name a new folder, or remove that one first")
    try:
        lines, geometry = read_line_integrals(path)
    except InputError as error:
        if "holds counts" not in str(error):
            raise
        counts, geometry = read_counts(path)
        lines = counts.line_integrals(LEAST_COUNT)
    views = views_of(np.asarray(lines, float), geometry)
    for number, view in enumerate(views, start=1):
        write(view, folder / f"view{number:06d}.dcm")
    return len(views)


def views_of(lines: np.ndarray, geometry: OrbitGeometry) -> list[Dataset]:
    """The files of a scan.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
        Line integrals.

    Raises
    ------
    InputError
        For a parallel beam, and an arc about another point than the focal centre, which the format has no place for.
    """
    if geometry.parallel:
        raise InputError("DICOM-CT-PD: has fan beams alone; the scan's beam is parallel")
    if geometry.surface != FLAT and geometry.arc_radius_mm != geometry.source_to_detector_mm:
        raise InputError("DICOM-CT-PD: has arcs about the focal centre alone; the detector is one about another point")
    low = _rounded(lines.min())
    slope = _rounded(max(float(lines.max()) - float(low), 1e-6) / GREATEST * (1 + 1e-9))
    content = hashlib.sha256(np.ascontiguousarray(lines).tobytes()).hexdigest()
    shared = _shared(geometry, low, slope, content)
    along, away, up = geometry.spots_mm[geometry.spot_of_view].T
    radius = geometry.source_to_isocentre_mm
    turned, distance = np.arctan2(-along, radius + away), np.hypot(along, radius + away)
    files = []
    for view, image in enumerate(lines):
        one = Dataset()
        one.update(shared)
        one.InstanceNumber = view + 1
        one.SOPInstanceUID = uid(content, "view", view)
        _add(one, FOCAL_ANGLE, float(geometry.angles_rad[view] % (2 * math.pi)))
        _add(one, FOCAL_Z, float(geometry.source_z_mm[view]))
        _add(one, SPOT_ANGLE, float(turned[view]))
        _add(one, SPOT_Z, float(up[view]))
        _add(one, SPOT_RADIUS, float(distance[view] - radius))
        # One column of the detector after another, its rows along -z, as in the public library.
        stored = np.rint((image[::-1].T - float(low)) / float(slope))
        one.PixelData = np.ascontiguousarray(np.clip(stored, 0, GREATEST), "<u2").tobytes()
        one["PixelData"].VR = "OW"
        one.file_meta = FileMetaDataset()
        one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID
        one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID
        files.append(one)
    return files


def _shared(geometry: OrbitGeometry, low: DSfloat, slope: DSfloat, content: str) -> Dataset:
    """What all views hold."""
    ds = Dataset()
    ds.SOPClassUID, ds.Modality = CTImageStorage, "CT"
    ds.PatientName, ds.PatientID, ds.PatientBirthDate, ds.PatientSex = "Virtual^Phantom", content[:12], "", ""
    ds.StudyInstanceUID, ds.SeriesInstanceUID = uid(content, "study"), uid(content, "series")
    ds.StudyDate, ds.StudyTime, ds.StudyID, ds.AccessionNumber, ds.ReferringPhysicianName = "", "", "", "", ""
    ds.SeriesNumber, ds.ImageType = 1, ["ORIGINAL", "PRIMARY", "AXIAL"]
    ds.Manufacturer, ds.ManufacturerModelName, ds.SoftwareVersions = NAME, "simulation", __version__
    ds.SamplesPerPixel, ds.PhotometricInterpretation = 1, "MONOCHROME2"
    ds.Rows, ds.Columns = geometry.columns, geometry.rows
    ds.BitsAllocated, ds.BitsStored, ds.HighBit, ds.PixelRepresentation = 16, 16, 15, 0
    ds.RescaleIntercept, ds.RescaleSlope, ds.RescaleType, ds.KVP = low, slope, "US", None
    ds.DataCollectionDiameter = _rounded(2 * geometry.field_of_view_radius_mm)
    if geometry.view_interval_ms is not None:
        ds.ExposureTime = round(geometry.view_interval_ms * geometry.views_per_rotation)
    for group, name in CREATORS.items():
        ds.add_new((group, 0x0010), "LO", name)
    for tag, value in (
        (ROWS, geometry.rows),
        (COLUMNS, geometry.columns),
        (WIDTH, float(geometry.column_pitch_mm)),
        (HEIGHT, float(geometry.row_pitch_mm)),
        (SHAPE, geometry.surface.upper()),
        (FOCAL_RADIUS, float(geometry.source_to_isocentre_mm)),
        (DISTANCE, float(geometry.source_to_detector_mm)),
        (
            CENTRAL,
            [
                (geometry.columns + 1) / 2 - geometry.column_offset_px,
                (geometry.rows + 1) / 2 + geometry.row_offset_px,
            ],
        ),
        (SPOT_MODE, MODES[bool(np.ptp(geometry.spots_mm[:, 0])), bool(np.ptp(geometry.spots_mm[:, 2]))]),
        (VIEWS_PER_TURN, round(geometry.views_per_rotation)),
        (SOURCES, 1),
        (TRAJECTORY, "HELICAL" if geometry.feed_per_rotation_mm else "AXIAL"),
        (BEAM, "FANBEAM"),
        *((tag, "NO") for tag in CORRECTIONS.values()),
        (LOGARITHM, "YES"),
    ):
        _add(ds, tag, value)
    return ds


def _add(ds: Dataset, tag: tuple[int, int], value: object) -> None:
    ds.add_new(tag, "FL" if tag in FLOATS else "US" if tag in WHOLE else "CS", value)


def _rounded(value: float) -> DSfloat:
    """As a decimal string of DICOM's 16 characters."""
    return DSfloat(float(value), auto_format=True)
