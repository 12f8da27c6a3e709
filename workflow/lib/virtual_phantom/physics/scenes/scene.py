"""What is scanned: the path length of every ray through each material."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from ...base.geometry import Grid, ScanGeometry
from ...base.pose import IN_PLACE, Pose, turned_back
from ...io.volumes import Volume
from ...projectors.cpu import check_in_orbit
from ..beam.materials import Segmentation, attenuation_per_mm, energy_of
from .rays import Rays, Voxels

DISC_ENERGY_KEV = 60.0  # of the monochromatic beam where none is stated: about the mean of a body scan at 120 kV
# Of what goes on beyond a volume: amount in a voxel of the last slice from which on the object is cut there (air of a
# real scan is not empty), and slices.
LEAST_CUT, MOST_BEYOND = 0.25, 32


class VoxelScene:
    """A volume divided into materials. The grid's centre lies at the isocentre.

    Parameters
    ----------
    fractions : ndarray, shape (materials, z, y, x)
        Amounts relative to the listed densities.
    materials : tuple of str
        Of materials.COMPOUNDS or ELEMENTS.
    energy_kev : float
        Of the monochromatic beam, keV.
    """

    def __init__(self, fractions: np.ndarray, grid: Grid, materials: tuple[str, ...], energy_kev: float, threads=1):
        self.materials, self.energy_kev, self.threads = materials, energy_kev, threads
        # A source outside the grid's corners is all that the projector asks for: cut away what is empty.
        occupied = np.argwhere((fractions > 0).any(axis=0))
        low, high = occupied.min(axis=0), occupied.max(axis=0) + 1
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        self.grid = replace(grid, shape=tuple((high - low).tolist()))
        middle = (low + high - np.array(grid.shape)) / 2 * grid.spacing
        self._centre = middle[::-1]
        self._fractions = fractions[:, *box]
        self._voxels = None
        self._at_ends = {-1: bool(low[0] == 0), 1: bool(high[0] == grid.shape[0])}

    @classmethod
    def of(cls, phantom: Volume, segmentation: Segmentation, mu_water_per_mm: float, threads: int = 1) -> VoxelScene:
        """The scene of a phantom in HU."""
        fractions = segmentation.fractions(phantom.array, mu_water_per_mm)
        energy = energy_of("water", mu_water_per_mm)
        return cls(fractions, phantom.grid, segmentation.materials, energy, threads)

    def moved(self, by_mm: np.ndarray) -> VoxelScene:
        """The same scene, its grid displaced by x, y, z in mm."""
        moved = copy.copy(self)
        moved._centre = self._centre + by_mm
        return moved

    @property
    def radius_mm(self) -> float:
        """How far it reaches from the z axis at most, mm."""
        return reach_mm(self.grid, self._centre)

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """Of each material at the monochromatic energy, 1/mm, shape (materials,)."""
        return np.array([attenuation_per_mm(material, [self.energy_kev])[0] for material in self.materials])

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """Path lengths of every ray through each material.

        Parameters
        ----------
        motion_mm : ndarray, shape (views, 3), optional
            Where the object is in each view, (x, y, z) from its place, mm.

        Returns
        -------
        ndarray of float32, shape (materials, views, rows, columns)
            mm.

        Raises
        ------
        InputError
            If the grid's corners lie outside the source's orbit.
        """
        rays = self.rays(geometry, pose, motion_mm)
        return self._traceable.path_lengths(rays, self.threads).reshape(-1, *geometry.shape)

    def rays(
        self,
        geometry: ScanGeometry,
        pose: Pose = IN_PLACE,
        motion_mm: np.ndarray | None = None,
        along_x: np.ndarray | None = None,
    ) -> Rays:
        """The rays of a scan in the grid's coordinates; along_x as Rays.of takes it."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        grid, centre_mm = self._sized(pose.size), pose.size * self._centre + shift
        check_in_orbit(geometry, grid, centre_mm)
        return Rays.of(geometry, grid, centre_mm, along_x)

    def slopes(self, rays: Rays) -> np.ndarray:
        """As Voxels.slopes."""
        return self._traceable.slopes(rays, self.threads)

    @property
    def _traceable(self) -> Voxels:
        if self._voxels is None:
            self._voxels = Voxels(self._fractions)
        return self._voxels

    @property
    def whole_voxels(self) -> bool:
        """As Voxels.whole."""
        return self._traceable.whole

    @property
    def ends_mm(self) -> tuple[float, float]:
        """The least and the largest z of its matter, mm."""
        half = self.grid.extent_mm[0] / 2
        return float(self._centre[2] - half), float(self._centre[2] + half)

    def beyond(self, end: int, height_mm: float) -> VoxelScene | None:
        """What there would be beyond an end of the volume, if the object went on like its last slice.

        Parameters
        ----------
        end : int
            -1: below the volume; 1: above it.
        height_mm : float
            How far it goes on.

        Returns
        -------
        VoxelScene or None
            None where the object ends within the volume.
        """
        last = self._fractions[:, 0 if end < 0 else -1]
        if not self._at_ends[end] or last.sum(axis=0).max() < LEAST_CUT:
            return None
        step = self.grid.spacing[0]
        count = math.ceil(height_mm / step)
        if count > MOST_BEYOND:
            count, step = MOST_BEYOND, height_mm / MOST_BEYOND
        found = copy.copy(self)
        found._voxels, found._fractions = None, np.repeat(last[:, None], count, axis=1)
        found.grid = replace(self.grid, shape=found._fractions.shape[1:], spacing=(step, *self.grid.spacing[1:]))
        place = self.ends_mm[0 if end < 0 else 1] + end * count * step / 2
        found._centre = np.array([*self._centre[:2], place])
        return found

    def _sized(self, size: float) -> Grid:
        return self.grid if size == 1 else replace(self.grid, spacing=tuple(size * s for s in self.grid.spacing))


def reach_mm(grid: Grid, centre_mm: np.ndarray) -> float:
    """How far the corners of a grid whose centre lies at (x, y, z) are from the z axis, mm."""
    half = np.array(grid.extent_mm[:0:-1]) / 2
    return float(np.hypot(*(np.abs(centre_mm[:2]) + half)))


class DiscScene:
    """A homogeneous cylinder along z, longer than the beam is high: path lengths in closed form.

    Parameters
    ----------
    diameter_mm : float
        At size 1; its axis lies at the isocentre.
    material : str
        Of materials.COMPOUNDS or ELEMENTS.
    mu_per_mm : float, optional
        Of the monochromatic beam in the material, 1/mm: gives its energy; None: 60 keV.

    Raises
    ------
    InputError
        If the material attenuates like this at no energy.
    """

    threads = 1

    def __init__(self, diameter_mm: float, material: str, mu_per_mm: float | None = None):
        self.radius_mm, self.materials = diameter_mm / 2, (material,)
        self.energy_kev = DISC_ENERGY_KEV if mu_per_mm is None else energy_of(material, mu_per_mm)

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """At the monochromatic energy, 1/mm, shape (1,)."""
        return np.array([attenuation_per_mm(self.materials[0], [self.energy_kev])[0]])

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths; turns change nothing."""
        place = np.array([pose.x_mm, pose.y_mm, 0.0]) + (0.0 if motion_mm is None else motion_mm)
        x, y, _ = (geometry.source_mm - place).T[..., None]
        (to_x, to_y, to_z), rows = geometry.bundles()
        # In the plane: how far a ray passes from the axis, and its length to the detector.
        length = np.sqrt(to_x * to_x + to_y * to_y)
        off = (x * to_y - y * to_x) / length
        chord = 2 * np.sqrt(np.maximum((self.radius_mm * pose.size) ** 2 - off**2, 0))[:, None]
        # A ray that climbs is longer by its own length over that of its shadow in the plane.
        climb = np.sqrt(1 + ((to_z[:, None] + rows[:, None]) / length[:, None]) ** 2)
        return (chord * climb).astype(np.float32).reshape(1, *geometry.shape)
