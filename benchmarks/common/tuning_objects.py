"""The two phantoms of the blind validation and their materials.

The code that builds them is in `phantoms`, since its imports would delay the start of the workflow by a second.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...base.geometry import ImageProtocol
from ...base.settings import FbpSettings, GridSettings, MaterialSettings, ScanSettings, from_mapping
from ...io.schema import defaults_of

SOURCE_TO_ISOCENTRE_MM, SOURCE_TO_DETECTOR_MM = 541.0, 949.0
READOUT_KEV = 60.0  # converts a dark signal from photons to readout units: the simulator reads energy, in keV
MARGIN = 1.06  # width of the beam over the width of the phantom
SLICES = 4  # of images: slices that the beam covers in all views


@dataclass(frozen=True)
class Object:
    """A phantom of the suite.

    Attributes
    ----------
    layout : str
        File in the package's resources.
    extent_mm : tuple of 2 float
        Extent along (y, x), mm.
    least_mm : float
        Height that the layout needs, before the phantom is cut to the height of the beam, mm.
    soft, dense : str
        XCIST's materials. The density of `soft` is in proportion to the attenuation; above dense_from_hu, voxels are
        mixtures with `dense`.
    dense_from_hu : float
        HU.
    library_materials : tuple of 2 str
        Names of the corresponding materials of the library, which the diagnosis uses.
    """

    layout: str
    extent_mm: tuple[float, float]
    least_mm: float
    soft: str
    dense: str
    dense_from_hu: float
    library_materials: tuple[str, str]

    @property
    def stated(self) -> MaterialSettings:
        """Materials and HU threshold that the diagnosis uses."""
        return MaterialSettings(*self.library_materials, self.dense_from_hu)

    def pixel_mm(self, columns: int) -> float:
        """Return the width of a detector pixel at the isocenter for a beam that covers the phantom."""
        return max(self.extent_mm) * MARGIN / columns

    def detector(self, columns: int, rows: int) -> dict:
        """Return the scanner with the keys of the section `scan` of the configuration."""
        pitch = self.pixel_mm(columns) * SOURCE_TO_DETECTOR_MM / SOURCE_TO_ISOCENTRE_MM
        return {
            "source_to_isocentre_mm": SOURCE_TO_ISOCENTRE_MM,
            "source_to_detector_mm": SOURCE_TO_DETECTOR_MM,
            "columns": columns,
            "rows": rows,
            "column_pitch_mm": pitch,
            "row_pitch_mm": pitch,
        }

    def image_grid(self, columns: int) -> GridSettings:
        """Return the grid of images: voxels as wide as a detector pixel at the isocenter."""
        return GridSettings((SLICES, columns, columns), (self.pixel_mm(columns),) * 3, oversampling=1)

    def protocol(self, columns: int, rows: int, views: int, rotation_ms: float, engine: str) -> ImageProtocol:
        """Return the settings that the diagnosis of images knows.

        They describe the scan and a filtered back-projection. The hidden reconstruction is another one.

        Parameters
        ----------
        rotation_ms : float
            Rotation time, ms.
        engine : str
            Engine of the reconstruction.
        """
        circle = {"trajectory": "circular", "turns": 1.0, "rotation_time_ms": rotation_ms}
        scan = from_mapping(ScanSettings, defaults_of("scan") | circle | self.detector(columns, rows))
        grid, settings = self.image_grid(columns), FbpSettings(normalise="coverage")
        return ImageProtocol(scan, grid, projections=views, algorithm="fbp", settings=settings, engine=engine)


BONE = "ICRU_skeleton_cortical_bone_adult"
OBJECTS = {
    "quality_assurance": Object(
        "quality_assurance.yaml", (208.0, 208.0), 40.0, "water", BONE, 150.0, ("water", "bone")
    ),
    "abdomen": Object("phantom.yaml", (222.0, 302.0), 96.0, "ICRU_muscle_adult", BONE, 150.0, ("soft_tissue", "bone")),
}
