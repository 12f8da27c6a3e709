"""Errors of the stated object: density of each material, HU of a phantom, and location of edges.

Each error is a nuisance parameter with a Gaussian prior that changes the line integrals linearly. Its change per unit
is computed once, at the expected location of the object, so that fits need no further projection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...base.errors import InputError, did_you_mean
from ...base.geometry import ScanGeometry
from ...base.lru_cache import LRUCache
from ...base.pose import IN_PLACE, Pose
from ...io.volumes import Volume
from ...physics.scenes.sampling import average_rays, supersampled
from ...physics.scenes.scene import GridScene, Scene, VoxelScene
from ...physics.scenes.shapes import ShapesScene
from ..fitting.nuisance import Nuisance
from ..noise.condensed import Observed
from ..settings import ObjectUncertainty

DENSITY, SURFACE, HU = "density_of_", "surface_of_", "hu_near_"  # prefixes of names of parameters
SURFACE_VOXELS = 0.25  # additional SD of surfaces between voxels that have one material or none, in voxels
STEP_MM = 0.05  # growth of shapes for derivatives
# HU at which the error of a phantom in HU is a parameter; linear between them. Soft tissues differ by 20 HU or more.
NODES_HU = (-1000, -700, -300, -100, -50, 0, 25, 50, 75, 100, 150, 250, 500, 1000, 2000)
DENSE_HU = 150  # from here on the relative error of the density adds to the error in HU
# Amplitudes of two changes of the line integrals of voxels that have one material or none, mean and standard deviation.
# - partial_volume: by partial volumes at smooth surfaces; 0 for an object of voxels.
# - edge_blur: by a blur with a variance of half a squared voxel; interpolation between voxels blurs by a quarter.
EDGES = {"partial_volume": (0.5, 0.5), "edge_blur": (-0.5, 0.5)}
# Shares of these changes that remain after the fit as an error of each ray. For ellipsoids in binary voxels of 1 and
# 2 mm, and pixels of 2.2 mm, the remaining errors are that large.
LEFT = {"partial_volume": 0.75, "edge_blur": 0.5}
KEPT = 2  # whitened changes: of the fitted and of the held-out data


@dataclass(frozen=True)
class ObjectErrors:
    """Errors of the stated object.

    Attributes
    ----------
    numbers : tuple of Nuisance
        One for each error of a density or HU.
    changes : ndarray of float32, shape (numbers, views, rows, columns)
        Change of line integrals per unit.
    edges : mapping of str to ndarray, shape (views, rows, columns)
        Changes of EDGES, which are fitted as numerical distortions.
    """

    numbers: tuple[Nuisance, ...] = ()
    changes: np.ndarray = field(default_factory=lambda: np.zeros((0, 1, 1, 1), np.float32))
    edges: Mapping[str, np.ndarray] = field(default_factory=dict)
    _kept: LRUCache = field(default_factory=lambda: LRUCache(KEPT), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(number.name for number in self.numbers)

    @property
    def edge_numbers(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters of the edges."""
        return tuple(Nuisance(name, "1", *EDGES[name]) for name in self.edges)

    @property
    def left(self) -> tuple[np.ndarray, ...]:
        """Standard deviations of the errors at edges that remain after the fit."""
        return tuple(LEFT[name] * change for name, change in self.edges.items())

    def whitened(self, data: Observed) -> np.ndarray:
        """Return the whitened changes, shape (numbers, data)."""

        def make() -> tuple[Observed, np.ndarray]:  # the key is valid while the data are in the cache
            columns = [data.whitened(np.where(data.usable, change, 0)).ravel() for change in self.changes]
            return data, np.stack(columns) if columns else np.zeros((0, data.mean.size))

        return self._kept.get(id(data), make)[1]

    def lines(self, nuisance: Mapping[str, float]) -> np.ndarray:
        """Return the change of the line integrals, shape (views, rows, columns)."""
        return np.tensordot([nuisance[name] for name in self.names], self.changes, 1)


@dataclass(frozen=True)
class StatedObject:
    """Object of a recording with its uncertainty: a scene, or a phantom in HU.

    Attributes
    ----------
    phantom : Volume or None
        HU, if the object is a phantom.
    """

    scene: Scene
    uncertainty: ObjectUncertainty
    mu_water_per_mm: float
    phantom: Volume | None = None

    def errors(self, geometry: ScanGeometry, samples: int, pose: Pose = IN_PLACE) -> ObjectErrors:
        """Return the errors of the object in a scan with `samples` rays per pixel and direction.

        Raises
        ------
        InputError
            If an uncertainty is stated for a material that the object does not have, for materials of a phantom, or for
            a single material.
        """
        names, stated = [str(material) for material in self.scene.materials], self.uncertainty.materials
        if stated and (self.phantom is not None or len(names) == 1):
            key = "alignment: {scale: SD}" if self.phantom is None else "object_uncertainty: {hu: SD}"
            raise InputError(f"object_uncertainty.materials: the object is not of several materials; use {key}")
        for name in stated:
            if name not in names:
                raise InputError(
                    f"object_uncertainty.materials: the object has no material '{name}'; {did_you_mean(name, names)}"
                )
        return ObjectErrors(*self._amounts(geometry, samples, pose), self._edges(geometry, samples, pose))

    def _edges(self, geometry: ScanGeometry, samples: int, pose: Pose) -> dict[str, np.ndarray]:
        """Return the changes of EDGES; none for shapes, and for a phantom, whose voxels are a numerical error."""
        if self.phantom is not None or not isinstance(self.scene, GridScene):
            return {}

        def lines(scene: GridScene) -> np.ndarray:
            lengths = _lengths(scene, geometry, samples, pose)
            return np.tensordot(scene.attenuation_per_mm.astype(np.float32), lengths, 1)

        binary = self.scene.is_binary
        partial = self.scene.with_partial_volumes() if binary else self.scene
        here = lines(partial)
        return ({"partial_volume": here - lines(self.scene)} if binary else {}) | {
            "edge_blur": lines(partial.blurred()) - here
        }

    def _amounts(self, geometry: ScanGeometry, samples: int, pose: Pose) -> tuple[tuple[Nuisance, ...], np.ndarray]:
        """Return the errors of densities or HU, and their changes."""
        if self.phantom is not None:
            scene, numbers = self._hu_errors()
            per_mm = np.float32(self.mu_water_per_mm / 1000)
            return tuple(numbers), per_mm * _lengths(scene, geometry, samples, pose)
        if len(self.scene.materials) > 1:  # density and size of a single material are those of the alignment
            return self._of_materials(geometry, samples, pose)
        return (), np.zeros((0, *geometry.shape), np.float32)

    def _of_materials(
        self, geometry: ScanGeometry, samples: int, pose: Pose
    ) -> tuple[tuple[Nuisance, ...], np.ndarray]:
        """Return the errors of density and surface of each material, and their changes."""
        scene, uncertainty = self.scene, self.uncertainty
        names, mu = list(map(str, scene.materials)), scene.attenuation_per_mm[:, None, None, None].astype(np.float32)
        densities = [Nuisance(DENSITY + name, "1", 0.0, uncertainty.density_of(name)) for name in names]
        surface_mm = uncertainty.surface_mm
        if isinstance(scene, GridScene) and scene.is_binary:
            surface_mm = float(np.hypot(surface_mm, SURFACE_VOXELS * scene.grid.spacing[2]))
        surfaces = [Nuisance(SURFACE + name, "mm", 0.0, surface_mm) for name in names]
        lengths = _lengths(scene, geometry, samples, pose)
        if isinstance(scene, ShapesScene):
            grown = (scene.grown(material, STEP_MM) for material in scene.materials)
            steps = [(_lengths(other, geometry, samples, pose) - lengths) / STEP_MM for other in grown]
            growth = np.stack([(mu * step).sum(axis=0) for step in steps])
        else:
            growth = _lengths(scene.growth(), geometry, samples, pose)
        return (*densities, *surfaces), np.concatenate([mu * lengths, growth])

    def _hu_errors(self) -> tuple[Scene, list[Nuisance]]:
        """Return a scene with the share of each node of NODES_HU in the phantom, and the parameters."""
        hu, scene = self.phantom.array, self.scene
        shares = np.stack([np.interp(hu, NODES_HU, tent).astype(np.float32) for tent in np.eye(len(NODES_HU))[1:]])
        nodes, there = np.array(NODES_HU[1:]), shares.any(axis=(1, 2, 3))
        density = self.uncertainty.density * np.where(nodes > DENSE_HU, nodes + 1000, 0)
        sds = np.hypot(self.uncertainty.hu, density)[there]
        numbers = [Nuisance(f"{HU}{node}", "HU", 0.0, float(sd)) for node, sd in zip(nodes[there], sds, strict=True)]
        materials = ("water",) * len(numbers)
        return VoxelScene(shares[there], self.phantom.grid, materials, scene.energy_kev, scene.threads), numbers


def words_of(name: str, error: float) -> str:
    """Return an error of the object in words."""
    denser = "denser" if error > 0 else "less dense"
    if name.startswith(HU):
        return f"voxels near {name.removeprefix(HU)} HU that are {abs(error):.2g} HU {denser} than stated"
    if name.startswith(SURFACE):
        larger = "larger" if error > 0 else "smaller"
        return f"{name.removeprefix(SURFACE)} with a surface that is {abs(error):.2g} mm {larger} than stated"
    return f"{name.removeprefix(DENSITY)} that is {100 * abs(error):.2g} % {denser} than stated"


def _lengths(scene: Scene, geometry: ScanGeometry, samples: int, pose: Pose) -> np.ndarray:
    """Return mean path lengths of the rays of each pixel, mm, float32, shape (materials, views, rows, columns)."""
    return sum(
        average_rays(scene.path_lengths(rays, pose), weights).astype(np.float32)
        for rays, weights in supersampled(geometry, samples)
    )
