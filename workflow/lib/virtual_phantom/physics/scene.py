"""What is scanned: the path length of every ray through each material."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry import Grid, ScanGeometry
from ..projectors.cpu import CpuProjector
from ..volumes import Volume
from .materials import Segmentation, attenuation_per_mm, energy_of


@dataclass(frozen=True)
class Pose:
    """How the object lies off the place that it is said to have: shift in mm, turn about z in degrees."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0
    turn_deg: float = 0.0


IN_PLACE = Pose()


class VoxelScene:
    """A volume divided into materials.

    fractions    [material, z, y, x], amounts relative to the listed densities
    materials    their names
    energy_kev   of the monochromatic beam
    The grid's centre lies at the isocentre.
    """

    def __init__(self, fractions: np.ndarray, grid: Grid, materials: tuple[str, ...], energy_kev: float, threads=1):
        self.materials, self.energy_kev, self.threads = materials, energy_kev, threads
        # A source outside the grid's corners is all that the projector asks for: cut away what is empty.
        occupied = np.argwhere((fractions > 0.02).any(axis=0))
        low, high = occupied.min(axis=0), occupied.max(axis=0) + 1
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        self.grid = replace(grid, shape=tuple((high - low).tolist()))
        middle = (low + high - np.array(grid.shape)) / 2 * grid.spacing
        self._centre = middle[::-1]
        self._fractions = fractions[:, *box]
        self._packed = None

    @classmethod
    def of(cls, phantom: Volume, segmentation: Segmentation, mu_water_per_mm: float, threads: int = 1) -> VoxelScene:
        """The scene of a phantom in HU."""
        fractions = segmentation.fractions(phantom.array, mu_water_per_mm)
        energy = energy_of("water", mu_water_per_mm)
        return cls(fractions, phantom.grid, segmentation.materials, energy, threads)

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """Of each material at the monochromatic energy, (material,)."""
        return np.array([attenuation_per_mm(material, [self.energy_kev])[0] for material in self.materials])

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """[material, view, row, column] in mm, float32.

        motion_mm   (view, 3): where the object is in each view, x, y, z from its place
        """
        geometry = replace(geometry, angles_rad=geometry.angles_rad - np.deg2rad(pose.turn_deg))
        turn = np.deg2rad(pose.turn_deg)
        # The object turned by t about z and seen at angle b is the object seen at b - t, with shifts turned back.
        back = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        shift = back @ [pose.x_mm, pose.y_mm, pose.z_mm]
        if motion_mm is None:
            return self._project(geometry, shift)
        moved = shift + motion_mm @ back.T
        result = np.empty((len(self.materials), geometry.views, geometry.rows, geometry.columns), np.float32)
        for view in range(geometry.views):
            one = replace(
                geometry,
                angles_rad=geometry.angles_rad[view : view + 1],
                source_z_mm=geometry.source_z_mm[view : view + 1],
            )
            result[:, view] = self._project(one, moved[view])[:, 0]
        return result

    def _project(self, geometry: ScanGeometry, shift: np.ndarray) -> np.ndarray:
        centre = tuple((self._centre + shift).tolist())
        projector = CpuProjector(geometry, self.grid, len(self.materials), self.threads, centre)
        if self._packed is None:
            self._packed = projector.pack_volume(self._fractions)
        return projector.unpack_projections(projector.forward(self._packed))
