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
from ...physics.scenes.scene import Scene, VoxelScene
from ..fitting.nuisance import Nuisance
from ..noise.condensed import Observed
from ..settings import ObjectUncertainty

DENSITY, HU = "density_of_", "hu_near_"  # prefixes of names of parameters
# HU at which the error of a phantom in HU is a parameter; linear between them. Soft tissues differ by 20 HU or more.
NODES_HU = (-1000, -700, -300, -100, -50, 0, 25, 50, 75, 100, 150, 250, 500, 1000, 2000)
DENSE_HU = 150  # from here on the relative error of the density adds to the error in HU
KEPT = 2  # whitened changes: of the fitted and of the held-out data


@dataclass(frozen=True)
class ObjectErrors:
    """Errors of the stated object.

    Attributes
    ----------
    numbers : tuple of Nuisance
        One for each error.
    changes : ndarray of float32, shape (numbers, views, rows, columns)
        Change of line integrals per unit.
    """

    numbers: tuple[Nuisance, ...] = ()
    changes: np.ndarray = field(default_factory=lambda: np.zeros((0, 1, 1, 1), np.float32))
    _kept: LRUCache = field(default_factory=lambda: LRUCache(KEPT), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(number.name for number in self.numbers)

    def whitened(self, data: Observed) -> np.ndarray:
        """Return the whitened changes, shape (numbers, data)."""

        def make() -> tuple[Observed, np.ndarray]:  # the key is valid as long as the data are kept
            columns = [data.whitened(np.where(data.usable, change, 0)).ravel() for change in self.changes]
            return data, np.stack(columns) if columns else np.zeros((0, data.mean.size))

        return self._kept.get(id(data), make)[1]

    def lines(self, nuisance: Mapping[str, float]) -> np.ndarray:
        """Return the change of the line integrals, shape (views, rows, columns)."""
        return np.tensordot([nuisance[name] for name in self.names], self.changes, 1)


@dataclass(frozen=True)
class StatedObject:
    """What is known of an object: its scene, or a phantom in HU, with the uncertainty.

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
            If an uncertainty is stated for a material that the object does not have.
        """
        known = dict(self.uncertainty.materials)
        names = [str(material) for material in self.scene.materials]
        for name in known:
            if name not in names:
                raise InputError(
                    f"object_uncertainty.materials: the object has no material '{name}'; {did_you_mean(name, names)}"
                )
        if self.phantom is not None:
            scene, numbers = self._hu_errors()
            per_mm = np.full(len(numbers), self.mu_water_per_mm / 1000)
        elif len(names) > 1:  # the density of a single material is the density scale
            scene, per_mm = self.scene, self.scene.attenuation_per_mm
            density = self.uncertainty.density
            numbers = [Nuisance(DENSITY + name, "1", 0.0, known.get(name, density)) for name in names]
        else:
            return ObjectErrors()
        return ObjectErrors(tuple(numbers), per_mm[:, None, None, None] * _lengths(scene, geometry, samples, pose))

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
    return f"{name.removeprefix(DENSITY)} that is {100 * abs(error):.2g} % {denser} than stated"


def _lengths(scene: Scene, geometry: ScanGeometry, samples: int, pose: Pose) -> np.ndarray:
    """Return mean path lengths of the rays of each pixel, mm, float32, shape (materials, views, rows, columns)."""
    return sum(
        average_rays(scene.path_lengths(rays, pose), weights).astype(np.float32)
        for rays, weights in supersampled(geometry, samples)
    )
