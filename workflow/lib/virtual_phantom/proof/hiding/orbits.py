"""Scan geometries of the cases: circles with a flat or cylindrical detector, short scans and helices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.geometry import Grid
from ...base.proof_settings import ProofProtocol, ProofScan
from ...base.vectors import CYLINDRICAL, FLAT
from .objects import DISTANCES_MM, ScannedObject

FULL, ARC, SHORT, HELIX = GEOMETRIES = ("flat", "arc", "short_scan", "helical")
SLICES = 4  # of images: slices that the beam covers in all views
BEYOND_FAN_DEG = 15.0  # of a short scan: views beyond 180 degrees and the fan
HELIX_TURNS, PITCH = 2.0, 0.8  # turns, and table feed per turn over the height of the beam


@dataclass(frozen=True)
class Orbit:
    """Source and detector on a circle or a helix, in terms of a recording (base.geometry).

    At angle 0 the source is at +y. Lengths are in mm.

    Attributes
    ----------
    surface : {"flat", "cylindrical"}, optional
        Shape of the detector; the axis of a cylinder passes through the source.
    turns : float
        Turns of all views together.
    feed_mm : float
        Rise of the source per turn, mm.
    """

    views: int
    columns: int
    rows: int
    column_pitch_mm: float
    row_pitch_mm: float
    source_to_isocentre_mm: float
    source_to_detector_mm: float
    surface: str = FLAT
    column_offset_px: float = 0.0
    turns: float = 1.0
    feed_mm: float = 0.0
    start_angle_deg: float = 0.0

    @property
    def views_per_rotation(self) -> float:
        """Views per turn."""
        return self.views / self.turns

    @property
    def start_z_mm(self) -> float:
        """Height of the source in the first view, so that the middle of the scan is at the isocenter, mm."""
        return -self.feed_mm * (self.views - 1) / 2 / self.views_per_rotation if self.feed_mm else 0.0

    def recorded(self, rotation_ms: float) -> dict:
        """Return the section `scan` of recording.yaml."""
        scan = {
            "trajectory": "helical" if self.feed_mm else "circular",
            "detector": self.surface,
            "illumination": "solid_angle",
            "source_to_isocentre_mm": self.source_to_isocentre_mm,
            "source_to_detector_mm": self.source_to_detector_mm,
            "columns": self.columns,
            "rows": self.rows,
            "column_pitch_mm": self.column_pitch_mm,
            "row_pitch_mm": self.row_pitch_mm,
            "column_offset_px": self.column_offset_px,
            "views": self.views,
            "views_per_rotation": self.views_per_rotation,
            "start_angle_deg": self.start_angle_deg,
            "direction": 1,
            "rotation_time_ms": rotation_ms,
            "exposure_ms": 0.0,  # one flash in the middle of each interval
        }
        return scan | ({"table_feed_mm": self.feed_mm, "start_z_mm": self.start_z_mm} if self.feed_mm else {})


def orbit_of(
    geometry: str, scanned: ScannedObject, detector: ProofScan, protocol: ProofProtocol, start_angle_deg: float
) -> Orbit:
    """Return the orbit of one of GEOMETRIES.

    A helix has fewer views per turn, and short scans fewer views in all, so that all cases take about as long.
    """
    near, far = DISTANCES_MM[scanned.kind]
    pixel = scanned.pixel_mm(detector.columns)
    pitch, views, turns, feed = pixel * far / near, protocol.views, 1.0, 0.0
    if geometry == SHORT:
        fan = np.degrees(2 * np.arctan(detector.columns * pitch / 2 / far))
        turns = float(180 + fan + BEYOND_FAN_DEG) / 360
        views = int(np.ceil(views * turns))
    elif geometry == HELIX:
        turns, feed = HELIX_TURNS, PITCH * detector.rows * pixel
    return Orbit(
        views=views,
        turns=turns,
        feed_mm=feed,
        start_angle_deg=start_angle_deg,
        surface=CYLINDRICAL if geometry == ARC else FLAT,
        columns=detector.columns,
        rows=detector.rows,
        column_pitch_mm=pitch,
        row_pitch_mm=pitch,
        source_to_isocentre_mm=near,
        source_to_detector_mm=far,
        column_offset_px=0.25 if geometry == ARC else 0.0,
    )


def image_grid(orbit: Orbit) -> Grid:
    """Return the grid of images: voxels as wide as a detector pixel at the isocenter."""
    voxel = orbit.column_pitch_mm * orbit.source_to_isocentre_mm / orbit.source_to_detector_mm
    return Grid((SLICES, orbit.columns, orbit.columns), (voxel,) * 3)
