"""Export of projections as DICOM-CT-PD, the format of public low-dose CT data.

Every view is a file. Private elements hold the positions of the detector's focal center and the focal spot. Pixels are
rescaled line integrals. Element (row j, column i), counted from 1, is on an arc of radius d about the focal center. Its
fan angle is (i - X) w / d and its height z + (Y - j) h, so rows run along -z. base/geometry.py defines the frame.

References
----------
B. Chen et al., Med. Phys. 42, 6964, 2015; T. R. Moen et al., Med. Phys. 48, 902, 2021.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset
from pydicom.valuerep import DSfloat

from ..base.errors import InputError
from ..base.geometry import OrbitGeometry
from ..base.vectors import FLAT
from .dicom_export import ct_image, simulated_ct, uid, write
from .exchange import read_counts, read_line_integrals

# Private elements: (group, element).
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
FLOATS = (  # elements of type FL
    *(WIDTH, HEIGHT, FOCAL_ANGLE, FOCAL_Z, FOCAL_RADIUS, DISTANCE),
    *(CENTRAL, SPOT_ANGLE, SPOT_Z, SPOT_RADIUS, PHOTONS),
)
INTEGERS = (ROWS, COLUMNS, VIEWS_PER_TURN, SOURCES)  # elements of type US; all others are of type CS
CREATORS = {  # names that reserve the private groups
    0x7029: "Detector System Arrangement Module",
    0x7031: "Detector Dynamics Module",
    0x7033: "Source Dynamics Module",
    0x7037: "Projection Data Definitions",
    0x7039: "Preprocessing Flags Module",
}
MAX_PIXEL = 65535
LEAST_COUNT = 0.5  # photons that replace a count of zero, as in the default study
# Flying focal spot modes, by whether spots differ along the columns and along z.
MODES = {(False, False): "FFSNONE", (True, False): "FFSXY", (False, True): "FFSZ", (True, True): "FFSXYZ"}


def export_projections(path: str | Path, folder: str | Path) -> int:
    """Write projections of a study (projections/.../*.h5) as DICOM-CT-PD, one file per view; return their number.

    Parameters
    ----------
    path : str or Path
        Line integrals, or counts, which are converted.
    folder : str or Path
        Created by this function.

    Raises
    ------
    InputError
        If the file has other content, the folder exists, or the format does not support the scan.
    """
    folder = Path(folder)
    if folder.exists():
        raise InputError(f"{folder}: exists already; give a new folder, or remove this one first")
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
    """Return one dataset per view from line integrals of shape (views, rows, columns).

    Raises
    ------
    InputError
        For a parallel beam or an arc about another point than the focal center, which the format does not support.
    """
    if geometry.parallel:
        raise InputError("DICOM-CT-PD: supports fan beams only; the scan's beam is parallel")
    if geometry.surface != FLAT and geometry.arc_radius_mm != geometry.source_to_detector_mm:
        raise InputError("DICOM-CT-PD: supports only arcs about the focal center; the detector has another one")
    low = _rounded(lines.min())
    slope = _rounded(max(float(lines.max()) - float(low), 1e-6) / MAX_PIXEL * (1 + 1e-9))
    content = hashlib.sha256(np.ascontiguousarray(lines).tobytes()).hexdigest()
    shared = _shared(geometry, low, slope, content)
    along, away, up = geometry.spots_mm[geometry.spot_of_view].T
    radius = geometry.source_to_isocentre_mm
    turned, distance = np.arctan2(-along, radius + away), np.hypot(along, radius + away)
    files = []
    for view, image in enumerate(lines):
        # Detector columns are rows of the image, with detector rows along -z, as in the public library.
        stored = np.rint((image[::-1].T - float(low)) / float(slope))
        pixels = np.clip(stored, 0, MAX_PIXEL).astype("<u2")
        dataset = ct_image(shared, view + 1, uid(content, "view", view), pixels)
        _add(dataset, FOCAL_ANGLE, float(geometry.angles_rad[view] % (2 * math.pi)))
        _add(dataset, FOCAL_Z, float(geometry.source_z_mm[view]))
        _add(dataset, SPOT_ANGLE, float(turned[view]))
        _add(dataset, SPOT_Z, float(up[view]))
        _add(dataset, SPOT_RADIUS, float(distance[view] - radius))
        files.append(dataset)
    return files


def _shared(geometry: OrbitGeometry, low: DSfloat, slope: DSfloat, content: str) -> Dataset:
    """Return the elements that all views share."""
    ds = simulated_ct(content, content[:12], uid(content, "series"))
    ds.Rows, ds.Columns, ds.PixelRepresentation = geometry.columns, geometry.rows, 0
    ds.RescaleIntercept, ds.RescaleSlope, ds.RescaleType = low, slope, "US"
    ds.DataCollectionDiameter = _rounded(2 * geometry.field_of_view_radius_mm)
    if geometry.view_interval_ms is not None:
        ds.ExposureTime = round(geometry.view_interval_ms * geometry.views_per_rotation)
    for group, name in CREATORS.items():
        ds.add_new((group, 0x0010), "LO", name)
    central = [(geometry.columns + 1) / 2 - geometry.column_offset_px, (geometry.rows + 1) / 2 + geometry.row_offset_px]
    for tag, value in (
        (ROWS, geometry.rows),
        (COLUMNS, geometry.columns),
        (WIDTH, float(geometry.column_pitch_mm)),
        (HEIGHT, float(geometry.row_pitch_mm)),
        (SHAPE, geometry.surface.upper()),
        (FOCAL_RADIUS, float(geometry.source_to_isocentre_mm)),
        (DISTANCE, float(geometry.source_to_detector_mm)),
        (CENTRAL, central),
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
    ds.add_new(tag, "FL" if tag in FLOATS else "US" if tag in INTEGERS else "CS", value)


def _rounded(value: float) -> DSfloat:
    """Return a value as a decimal string of at most 16 characters, DICOM's limit."""
    return DSfloat(float(value), auto_format=True)
