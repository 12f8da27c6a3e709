"""Two phantoms on which the diagnosis was tuned, scanned by XCIST without imperfections.

The blind validation does not use them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.settings import MaterialSettings
from virtual_phantom.base.streams import Stream, generator
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import Phantom, Roi, layout, synthetic
from virtual_phantom.proof.hiding import generate
from virtual_phantom.proof.hiding.faults import faulty
from virtual_phantom.proof.hiding.materials import mixture
from virtual_phantom.proof.hiding.orbits import Orbit
from virtual_phantom.proof.hiding.readout import read_out
from virtual_phantom.proof.hiding.voxels import BEYOND_MM, REACH
from virtual_phantom.proof.hiding.xcist import Acquired, Materials, Scan, attenuation_per_mm, simulate

SOURCE_TO_ISOCENTRE_MM, SOURCE_TO_DETECTOR_MM = 541.0, 949.0
MARGIN = 1.06  # width of the beam over the width of the phantom
CHANGES = ("table_mm", "arm_radius_mm", "insert_hu")  # settings of faults of the object
LEAST_FRACTION = 1e-4  # smaller volume fractions are set to 0
FINER = 2  # subdivision of the known voxels in the scanned phantom
VOXELS_PER_PIXEL = 3  # known voxels per detector pixel at the isocenter


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


BONE = "ICRU_skeleton_cortical_bone_adult"
OBJECTS = {
    "quality_assurance": Object(
        "quality_assurance.yaml", (208.0, 208.0), 40.0, "water", BONE, 150.0, ("water", "bone")
    ),
    "abdomen": Object("phantom.yaml", (222.0, 302.0), 96.0, "ICRU_muscle_adult", BONE, 150.0, ("soft_tissue", "bone")),
}


def build(scanned_object: Object, layout_file: str | Path, columns: int, rows: int, seed: Stream) -> Phantom:
    """Build a phantom, cut to the height that a detector of columns x rows sees.

    `fine` of the result is scanned, `image` is known to the diagnosis. The seed draws the textures.

    Raises
    ------
    InputError
        As synthetic.build.
    """
    pixel = scanned_object.pixel_mm(columns)
    voxel = pixel / VOXELS_PER_PIXEL
    slices, seen = (
        int(np.ceil(height / voxel / 2)) * 2
        for height in (scanned_object.least_mm, rows * pixel * REACH + 2 * BEYOND_MM)
    )
    across = (int(np.ceil(extent / voxel / 2)) * 2 for extent in scanned_object.extent_mm)
    grid = Grid((max(slices, seen), *across), (voxel,) * 3)
    whole = synthetic.build(layout.read_layout(layout_file), grid, FINER, seed)
    image = _middle(whole.image, seen)
    rois = [Roi(roi.name, roi.tissue_class, _middle(Volume(roi.mask, grid), seen).array) for roi in whole.rois]
    return Phantom(_middle(whole.fine, seen * FINER), image, tuple(roi for roi in rois if roi.mask.any()))


def _middle(volume: Volume, slices: int) -> Volume:
    first = (volume.grid.shape[0] - slices) // 2
    grid = Grid((slices, *volume.grid.shape[1:]), volume.grid.spacing)
    return Volume(np.ascontiguousarray(volume.array[first : first + slices]), grid)


def materials(hu: Volume, scanned_object: Object, kev: float, mu_water_per_mm: float) -> Materials:
    """Divide HU into materials whose attenuation at one energy is mu_water_per_mm (1 + HU / 1000) in every voxel.

    Voxels are square in the plane.
    """
    mu = np.maximum(mu_water_per_mm * (1 + hu.array.astype(np.float64) / 1000), 0)
    names = scanned_object.soft, scanned_object.dense
    start = mu_water_per_mm * (1 + scanned_object.dense_from_hu / 1000)
    amounts = mixture(mu, start, *(attenuation_per_mm(name, kev) for name in names))
    fractions = dict(zip(names, amounts, strict=True))
    for fraction in fractions.values():
        fraction[fraction < LEAST_FRACTION] = 0
    height, plane = hu.grid.spacing[:2]
    return Materials({name: part.astype(np.float32) for name, part in fractions.items()}, (plane, height))


def orbit_of(scanned_object: Object, columns: int, rows: int, views: int) -> Orbit:
    """Return a circle around a phantom, with a flat detector."""
    detector = scanned_object.detector(columns, rows)
    return Orbit(views, **detector)


def scan_of(
    scanned_object: Object,
    taken: Mapping,
    kev: float,
    hidden: Mapping,
) -> tuple[Orbit, Scan]:
    """Return the orbit and the scan of the settings `taken`, with the keys of proof.scan, and the hidden settings."""
    orbit = orbit_of(scanned_object, taken["columns"], taken["rows"], taken["views"])
    return orbit, generate.scan_of(orbit, taken["photons"], taken["rotation_time_ms"], kev, hidden)


def acquire(
    scan: Scan, scanned_object: Object, fine: Volume, mu_water_per_mm: float, repeats: int, seed: Stream
) -> Acquired:
    """Scan the fine phantom (HU) and read out the detector.

    Raises
    ------
    InputError
        For a fault of the object.
    """
    if changes := set(CHANGES) & set(scan.settings):
        raise InputError(f"{min(changes)}: the phantoms of the benchmarks do not change; hide another fault")
    noise, pixels, faults = seed.spawn(3)
    taken = simulate(scan, materials(fine, scanned_object, scan.kev, mu_water_per_mm), repeats, noise)
    taken, pitch = faulty(taken, scan, generator(faults)), (scan.column_pitch_mm, scan.row_pitch_mm)
    return read_out(taken, scan.settings, pitch, scan.duration_s, generator(pixels))
