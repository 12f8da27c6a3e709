"""Scanned objects: the path length of every ray through each material."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from ...base.geometry import Grid, ScanGeometry
from ...base.pose import IN_PLACE, Pose, turned_back
from ...io.volumes import Volume
from ...projectors.cpu import check_in_orbit
from ..beam.materials import Material, Segmentation, attenuation_per_mm, energy_of
from .interfaces import divided, phases, sharpened
from .label_surfaces import Surfaces, shares_at
from .rays import Rays, Voxels

DISC_ENERGY_KEV = 60.0  # default energy of the monochromatic beam: about the mean of a body scan at 120 kV
# Continuation of a cut object: smallest amount of material in the last slice that counts as matter (air of a real scan
# is not empty), and largest number of slices.
MIN_CUT_AMOUNT, MAX_EXTENSION = 0.25, 32
MARGIN = 3  # voxels around an object with partial volumes
UNIFORM = 1 / 12  # variance of a uniformly distributed share


class Scene:
    """Base of all scenes: materials and the monochromatic beam.

    Subclasses add `path_lengths` and `radius_mm`, as VoxelScene has them.

    Attributes
    ----------
    materials : tuple of str or Mixture
        Names in materials.COMPOUNDS or ELEMENTS, or other materials.
    """

    materials: tuple[Material, ...]
    energy_kev: float
    threads = 1

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """Attenuation of each material at the monochromatic energy, 1/mm, shape (materials,)."""
        return np.array([attenuation_per_mm(material, [self.energy_kev])[0] for material in self.materials])


class GridScene(Scene):
    """Base of scenes on a voxel grid, which is cropped to the voxels that hold any material.

    Parameters
    ----------
    fractions : ndarray, shape (materials, z, y, x)
        Amount of each material in a voxel.
    grid : Grid
        Grid of `fractions`, with its center at the isocenter.
    materials, energy_kev
        As in Scene.

    Attributes
    ----------
    amounts : ndarray, shape (materials, z, y, x)
        The occupied part of `fractions`, or other amounts (see `with_amounts`).
    surfaces : Surfaces or None
        Surfaces of a scene by `with_partial_volumes`.
    """

    surfaces: Surfaces | None = None

    def __init__(self, fractions: np.ndarray, grid: Grid, materials: tuple[Material, ...], energy_kev: float):
        self.materials, self.energy_kev = materials, energy_kev
        occupied = np.argwhere((fractions > 0).any(axis=0))
        low, high = occupied.min(axis=0), occupied.max(axis=0) + 1
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        self.grid = replace(grid, shape=tuple((high - low).tolist()))
        self._center = ((low + high - np.array(grid.shape)) / 2 * grid.spacing)[::-1]
        self.amounts = fractions[:, *box]
        self._voxels = Voxels(self.amounts)
        self._at_ends = {-1: bool(low[0] == 0), 1: bool(high[0] == grid.shape[0])}

    @property
    def radius_mm(self) -> float:
        """Largest distance of the grid's corners from the z axis, mm."""
        half = np.array(self.grid.extent_mm[:0:-1]) / 2
        return float(np.hypot(*(np.abs(self._center[:2]) + half)))

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """Return the path length of every ray through each material.

        Parameters
        ----------
        geometry : ScanGeometry
            Or a sampling.SupersampledScan.
        motion_mm : ndarray, shape (views, 3), optional
            Displacement of the object in each view, (x, y, z), mm.

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
        return self._voxels.path_lengths(rays, self.threads).reshape(-1, *geometry.shape)

    def slopes(self, rays: Rays) -> np.ndarray:
        """As Voxels.slopes."""
        return self._voxels.slopes(rays, self.threads)

    def with_partial_volumes(self, contours: bool = True) -> GridScene:
        """Return the scene with partial volumes at surfaces, for voxels that have one material or none.

        Parameters
        ----------
        contours : bool, optional
            Whether surfaces follow contours (label_surfaces.distances).
        """
        amounts = np.pad(self.amounts, ((0, 0), (0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)))
        surfaces = Surfaces.of(amounts, contours)
        amounts[:, surfaces.near] = shares_at(surfaces.distance)[:-1]
        scene = self.with_amounts(amounts)
        scene.surfaces = surfaces
        return scene

    def attenuation(self, parts: tuple[int, int, int] = (1, 1, 1), shares: bool = True) -> GridScene:
        """Return the scene with the attenuation as its only amount, 1/mm, in parts of voxels with sharp interfaces.

        Parameters
        ----------
        parts : tuple of 3 int, optional
            Parts of a voxel along each axis.
        shares : bool, optional
            Whether amounts are shares of voxels; otherwise the neighbors' least and largest attenuation are mixed.
        """
        mu, margin = self.attenuation_per_mm.astype(np.float32), [(int(n > 1),) * 2 for n in self.grid.shape]
        amounts = np.pad(self.amounts, [(0, 0), *margin])
        if max(parts) == 1:
            total = np.tensordot(mu, amounts, 1)
        elif shares:
            total = sum(one * divided(amount, parts) for one, amount in zip(mu, amounts, strict=True))
        else:
            total = sharpened(np.tensordot(mu, amounts, 1), parts)
        return self.with_amounts(total[None], parts)

    def variance(self, shares: bool = True) -> GridScene:
        """Return the scene with the variance of the attenuation within voxels, 1/mm^2, as its only amount.

        It is that of two or more materials without regard to where they are in the voxel. Voxels that have one material
        or none have the variance of a share of unknown size if a neighbor differs.
        """
        margin = [(int(n > 1),) * 2 for n in self.grid.shape]
        mu, amounts = self.attenuation_per_mm.astype(np.float32), np.pad(self.amounts, [(0, 0), *margin])
        if shares and not self.is_binary:
            found = np.tensordot(mu**2, amounts, 1) - np.tensordot(mu, amounts, 1) ** 2
        else:
            mixed, low, high = phases(np.tensordot(mu, amounts, 1))
            found = (high - low) ** 2 * (UNIFORM if self.is_binary else mixed * (1 - mixed))
        return self.with_amounts(np.maximum(found, 0)[None])

    def blurred(self) -> GridScene:
        """Return the scene blurred by weights (1, 2, 1) / 4 along each axis."""
        amounts = np.pad(self.amounts, ((0, 0), (0, 0), (1, 1), (1, 1)))
        for axis in (1, 2, 3):
            amounts = ndimage.convolve1d(amounts, np.array([1, 2, 1]) / 4, axis, mode="nearest")
        return self.with_amounts(amounts)

    def with_amounts(self, amounts: np.ndarray, parts: tuple[int, int, int] = (1, 1, 1)) -> GridScene:
        """Return the scene with other amounts, on a grid with the same center whose voxels are divided into parts."""
        scene = copy.copy(self)
        scene.amounts, scene._voxels = amounts, Voxels(amounts)
        spacing = tuple(side / count for side, count in zip(self.grid.spacing, parts, strict=True))
        scene.grid = replace(self.grid, shape=amounts.shape[1:], spacing=spacing)
        return scene

    @property
    def is_binary(self) -> bool:
        """As Voxels.is_binary."""
        return self._voxels.is_binary


class VoxelScene(GridScene):
    """A volume divided into materials, as GridScene; `fractions` are relative to the listed densities."""

    def __init__(self, fractions: np.ndarray, grid: Grid, materials: tuple[str, ...], energy_kev: float, threads=1):
        super().__init__(fractions, grid, materials, energy_kev)
        self.threads = threads

    @classmethod
    def of(cls, phantom: Volume, segmentation: Segmentation, mu_water_per_mm: float, threads: int = 1) -> VoxelScene:
        """Return the scene of a phantom in HU."""
        fractions = segmentation.fractions(phantom.array, mu_water_per_mm)
        energy = energy_of("water", mu_water_per_mm)
        return cls(fractions, phantom.grid, segmentation.materials, energy, threads)

    def moved(self, by_mm: np.ndarray) -> VoxelScene:
        """Return the scene displaced by (x, y, z), mm."""
        moved = copy.copy(self)
        moved._center = self._center + by_mm
        return moved

    def rays(
        self,
        geometry: ScanGeometry,
        pose: Pose = IN_PLACE,
        motion_mm: np.ndarray | None = None,
        along_x: np.ndarray | None = None,
    ) -> Rays:
        """Return the rays of a scan in the grid's coordinates; `along_x` as Rays.of takes it."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        grid = self.grid
        if pose.size != 1:
            grid = replace(grid, spacing=tuple(pose.size * side for side in grid.spacing))
        center_mm = pose.size * self._center + shift
        check_in_orbit(geometry, grid, center_mm)
        return Rays.of(geometry, grid, center_mm, along_x)

    @property
    def ends_mm(self) -> tuple[float, float]:
        """Smallest and largest z of the object, mm."""
        half = self.grid.extent_mm[0] / 2
        return float(self._center[2] - half), float(self._center[2] + half)

    def beyond(self, end: int, height_mm: float) -> VoxelScene | None:
        """Return the continuation of the object beyond an end of the volume, which repeats the slice at this end.

        Parameters
        ----------
        end : int
            -1: below the volume; 1: above it.

        Returns
        -------
        VoxelScene or None
            None if the object ends within the volume.
        """
        last = self.amounts[:, 0 if end < 0 else -1]
        if not self._at_ends[end] or last.sum(axis=0).max() < MIN_CUT_AMOUNT:
            return None
        step = self.grid.spacing[0]
        count = math.ceil(height_mm / step)
        if count > MAX_EXTENSION:
            count, step = MAX_EXTENSION, height_mm / MAX_EXTENSION
        scene = copy.copy(self)
        scene.amounts = np.repeat(last[:, None], count, axis=1)
        scene._voxels = Voxels(scene.amounts)
        scene.grid = replace(self.grid, shape=scene.amounts.shape[1:], spacing=(step, *self.grid.spacing[1:]))
        z = self.ends_mm[0 if end < 0 else 1] + end * count * step / 2
        scene._center = np.array([*self._center[:2], z])
        return scene


def scan_key(geometry: ScanGeometry, pose: Pose, motion_mm: np.ndarray | None) -> Hashable:
    """Return a cache key of the rays of a scan in the object's frame."""
    return geometry.key, pose, None if motion_mm is None else motion_mm.tobytes()
