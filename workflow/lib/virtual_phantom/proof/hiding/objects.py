"""What the proof scans: two phantoms and what they are made of.

Apart from building them, which the start of the workflow would pay a second for.
"""

from __future__ import annotations

from dataclasses import dataclass

SOURCE_TO_ISOCENTRE_MM, SOURCE_TO_DETECTOR_MM = 541.0, 949.0
READOUT_KEV = 60.0  # readout units of a dark signal that is told in photons: the simulator reads energy, in keV
MARGIN = 1.06  # of the beam over the phantom's width
SLICES = 4  # of images: those that the beam sees from everywhere


@dataclass(frozen=True)
class Object:
    """A phantom of the suite.

    Attributes
    ----------
    layout : str
        File under resources.
    extent_mm : tuple of 2 float
        (y, x) that it fills, mm.
    least_mm : float
        Height that its layout asks for, before it is cut to what the beam sees, mm.
    soft, dense : str
        XCIST's materials: `soft`, its density following the HU, with `dense` mixed in from dense_from_hu on.
    dense_from_hu : float
        HU.
    told : tuple of 2 str
        The same two as the diagnosis is told, in the library's names.
    """

    layout: str
    extent_mm: tuple[float, float]
    least_mm: float
    soft: str
    dense: str
    dense_from_hu: float
    told: tuple[str, str]

    @property
    def stated(self) -> dict:
        """How HU are divided, as the section `materials` of the configuration."""
        soft, dense = self.told
        return {"soft": soft, "dense": dense, "dense_from_hu": self.dense_from_hu}

    def pixel_mm(self, columns: int) -> float:
        """Width of a detector pixel at the isocentre that lets the beam pass the whole phantom."""
        return max(self.extent_mm) * MARGIN / columns

    def detector(self, columns: int, rows: int) -> dict:
        """The scanner, as the section `scan` of the configuration names it."""
        pitch = self.pixel_mm(columns) * SOURCE_TO_DETECTOR_MM / SOURCE_TO_ISOCENTRE_MM
        return {
            "source_to_isocentre_mm": SOURCE_TO_ISOCENTRE_MM,
            "source_to_detector_mm": SOURCE_TO_DETECTOR_MM,
            "columns": columns,
            "rows": rows,
            "column_pitch_mm": pitch,
            "row_pitch_mm": pitch,
        }

    def image_grid(self, columns: int) -> dict:
        """Of reconstructed images, as the section `grid`: voxels as wide as pixels at the isocentre."""
        return {"shape": [SLICES, columns, columns], "spacing_mm": [self.pixel_mm(columns)] * 3}

    def protocol(self, columns: int, rows: int, views: int, rotation_ms: float, engine: str) -> dict:
        """What the diagnosis is told of images (diagnosis.images.setting.Protocol).

        That is the scan, and a filtered back-projection, which is not theirs.

        Parameters
        ----------
        rotation_ms : float
            Time of the turn, ms.
        engine : str
            Of the reconstruction.
        """
        circle = {"trajectory": "circular", "turns": 1.0, "pitch": 1.0, "start_angle_deg": 0.0}
        circle["rotation_time_ms"] = rotation_ms
        return {
            "scan": circle | self.detector(columns, rows) | {"column_offset_px": 0.0, "row_offset_px": 0.0},
            "grid": self.image_grid(columns),
            "projections": views,
            "algorithm": "fbp",
            "settings": {"normalise": "coverage"},
            "engine": engine,
        }


OBJECTS = {
    "quality_assurance": Object(
        "quality_assurance.yaml",
        (208.0, 208.0),
        40.0,
        "water",
        "ICRU_skeleton_cortical_bone_adult",
        150.0,
        ("water", "bone"),
    ),
    "abdomen": Object(
        "phantom.yaml",
        (222.0, 302.0),
        96.0,
        "ICRU_muscle_adult",
        "ICRU_skeleton_cortical_bone_adult",
        150.0,
        ("soft_tissue", "bone"),
    ),
}
