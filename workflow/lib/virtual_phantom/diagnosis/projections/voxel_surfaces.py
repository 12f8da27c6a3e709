"""Surfaces of the parts of a voxel volume: their change per unit, and the volume with displaced surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from ...base.units import HU_AIR
from ...physics.beam.materials import Material
from ...physics.scenes.label_surfaces import shares_at
from ...physics.scenes.scene import GridScene
from ...physics.scenes.shapes import NOTHING

EMPTY_HU = -500  # below it is air; the surface of the body is halfway between soft tissue and air
CONTRAST_HU = 40  # of parts within the body, from its median
# Parts of a phantom whose surfaces move on their own: the two largest ones of each kind, and all others together.
MOST_PARTS_OF_KIND, SURFACE_REACH = 3, 2  # voxels from a part, in which edges belong to it
MOST_BYTES = 1e9  # of the shares of all parts; in larger volumes, all voxels of a material are one part
MOSTLY = 0.5  # share of voxels that belong to a part, apart from its surface
WITH_CORNERS = np.ones((3, 3, 3))  # neighbors of a voxel in its part
STEP_VOXELS = 0.05  # displacement of surfaces for derivatives
LEAST_SLOPE = 1e-4  # relative to the steepest slope: below it, nothing moves


@dataclass(frozen=True)
class VoxelSurfaces:
    """A volume, and its change if the surface of a part grows.

    Attributes
    ----------
    values : ndarray, shape (z, y, x)
    growth : dict of str to ndarray, shape (z, y, x)
        Change of the values by name of the part, 1/mm.
    spacing_mm : tuple of 3 float
        Voxel size along z, y and x, mm.
    """

    values: np.ndarray
    growth: dict[str, np.ndarray]
    spacing_mm: tuple[float, float, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(self.growth)

    def grown(self, by_mm: Mapping[str, float]) -> VoxelSurfaces:
        """Return the volume with surfaces that are displaced outwards, by name of the part.

        Values move along their gradient g. The displacement is s G / |g| for a part that grows by s and changes the
        volume by G per unit.
        """
        if not any(by_mm.values()):
            return self
        axes, slopes, steep = _slopes(self.values, self.spacing_mm)
        change = sum(by * self.growth[name] for name, by in by_mm.items())
        points = np.argwhere((change != 0) & (steep > LEAST_SLOPE * steep.max())).T
        at, here = points.astype(float), tuple(points)
        for axis, slope in zip(axes, slopes, strict=True):
            at[axis] += (change * slope)[here] / steep[here] ** 2 / self.spacing_mm[axis]
        values = self.values.copy()
        values[here] = ndimage.map_coordinates(self.values, at, order=3, mode="nearest")
        now = _slopes(values, self.spacing_mm)[2]
        ratio = np.divide(now, steep, out=np.zeros_like(now), where=steep > LEAST_SLOPE * steep.max())
        growth = {name: ratio * change for name, change in self.growth.items()}
        return VoxelSurfaces(values, growth, self.spacing_mm)


@dataclass(frozen=True)
class LabelSurfaces:
    """As VoxelSurfaces, for the attenuation of labels, whose surfaces are displaced exactly.

    Attributes
    ----------
    scene : GridScene
        By GridScene.with_partial_volumes.
    distance : ndarray, shape (materials + 1, near voxels)
        As label_surfaces.Surfaces.distance, with the displacements.
    moved : dict of str to tuple of 2 ndarray
        By name of the part: the near voxels whose surfaces move with it, and the displacement of the surface of every
        material there if the part grows by 1. Where a part grows, its neighbors shrink.
    by_mm : mapping of str to float
        Displacements outwards; 0 for other parts.
    """

    scene: GridScene
    distance: np.ndarray
    moved: dict[str, tuple[np.ndarray, np.ndarray]]
    by_mm: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: GridScene, parts: Mapping[str, Part]) -> LabelSurfaces:
        """Return the surfaces of a scene and its parts."""
        materials = (*scene.materials, NOTHING)
        moved = {
            name: (
                np.flatnonzero(own[scene.surfaces.near]),
                np.array([[1.0 if one == parts[name].material else -1.0] for one in materials], np.float32),
            )
            for name, own in own_surfaces(parts).items()
        }
        return cls(scene, scene.surfaces.distance, moved)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(self.moved)

    @property
    def spacing_mm(self) -> tuple[float, float, float]:
        """Voxel size along z, y and x, mm."""
        return self.scene.grid.spacing

    def grown(self, by_mm: Mapping[str, float]) -> LabelSurfaces:
        """As VoxelSurfaces.grown."""
        distance = self.distance.copy()
        for name, by in by_mm.items():
            at, outwards = self.moved[name]
            distance[:, at] += outwards * np.float32((by - self.by_mm.get(name, 0.0)) / self.spacing_mm[2])
        return replace(self, distance=distance, by_mm=by_mm)

    @property
    def attenuation(self) -> np.ndarray:
        """Attenuation with the displaced surfaces, 1/mm, shape (z, y, x)."""
        found = np.tensordot(self.scene.attenuation_per_mm.astype(np.float32), self.scene.amounts, 1)
        found[self.scene.surfaces.near] = self._mixed(self.distance)
        return found

    @property
    def growth(self) -> dict[str, np.ndarray]:
        """Change of the attenuation by name of the part, 1/mm^2."""
        near, found = self.scene.surfaces.near, {}
        places = np.flatnonzero(near)
        for name, (at, outwards) in self.moved.items():
            low, high = (self._mixed(self.distance[:, at] + side * STEP_VOXELS * outwards) for side in (-1, 1))
            found[name] = np.zeros(near.shape, np.float32)
            found[name].ravel()[places[at]] = (high - low) / (2 * STEP_VOXELS * self.spacing_mm[2])
        return found

    def _mixed(self, distance: np.ndarray) -> np.ndarray:
        return np.tensordot(self.scene.attenuation_per_mm.astype(np.float32), shares_at(distance)[:-1], 1)


@dataclass(frozen=True)
class Part:
    """Connected voxels of a material, or a hole, with the share of each voxel that they fill, shape (z, y, x)."""

    material: Material
    share: np.ndarray


def labelled_parts(scene: GridScene, most: int) -> dict[str, Part]:
    """Return the connected parts of every material, and holes, by name.

    If there are more than `most`, or if the volume is large, parts of a material are not separated.
    """
    empty = np.maximum(1 - scene.amounts.sum(axis=0), 0)
    outside = ndimage.binary_dilation(_outside(empty > MOSTLY), iterations=SURFACE_REACH)
    holes = np.where(outside, 0, empty)
    shares = dict(zip((*scene.materials, NOTHING), (*scene.amounts, holes), strict=True))
    labels = {material: ndimage.label(share > MOSTLY, WITH_CORNERS) for material, share in shares.items()}
    thin = {str(one): Part(one, shares[one]) for one in scene.materials if not labels[one][1] and shares[one].any()}
    labels = {material: found for material, found in labels.items() if found[1]}
    count = sum(number for _, number in labels.values())
    if count > most or count * empty.nbytes > MOST_BYTES:
        return {str(material): Part(material, shares[material]) for material in labels} | thin
    found = thin
    for material, (voxels, number) in labels.items():
        nearest = None
        if number > 1:
            places = ndimage.distance_transform_edt(voxels == 0, return_distances=False, return_indices=True)
            nearest = voxels[tuple(places)]
        for one in range(1, number + 1):
            near = ndimage.binary_dilation(voxels == one, iterations=SURFACE_REACH)
            if nearest is not None:
                near &= nearest == one
            name = str(material) if number == 1 else f"{material} {one}"
            found[name] = Part(material, np.where(near, shares[material], 0))
    return found


def own_surfaces(parts: Mapping[str, Part]) -> dict[str, np.ndarray]:
    """Return the voxels whose surfaces move with each part: of two parts that touch, with the smaller one.

    Inserts and holes therefore keep their size if the part around them grows.
    """
    found, taken = {}, False
    for name in sorted(parts, key=lambda name: float(parts[name].share.sum())):
        there = ndimage.binary_dilation(parts[name].share > 0, iterations=SURFACE_REACH)
        found[name] = there & ~taken
        taken = taken | there
    return {name: found[name] for name in parts}


def growth_of(share: np.ndarray, values: np.ndarray, spacing_mm: tuple[float, float, float]) -> np.ndarray:
    """Return the change of values if the surface of a part grows, and its neighbors shrink, 1/mm.

    Parameters
    ----------
    share : ndarray, shape (z, y, x)
        Share of each voxel that the part fills.
    """
    _, slopes, steep = _slopes(share, spacing_mm)
    _, others, _ = _slopes(values, spacing_mm)
    along = sum(slope * other for slope, other in zip(slopes, others, strict=True))
    return np.divide(along, steep, out=np.zeros_like(steep), where=steep > 0).astype(np.float32)


def growth_of_parts(hu: np.ndarray, spacing_mm: tuple[float, float, float]) -> dict[str, np.ndarray]:
    """Return the change of a phantom if the surface of a part grows, HU/mm, by name of the part.

    Parts are the body, air within it, and parts of another density. Other edges are left to the errors of HU.
    """
    steep = _slopes(np.maximum(hu, HU_AIR), spacing_mm)[2]
    empty = hu < EMPTY_HU
    outside = _outside(empty)
    parts, found = [("body", ~outside, 1)], {}
    tissue = ~ndimage.binary_dilation(empty, iterations=SURFACE_REACH)
    middle = float(np.median(hu[tissue])) if tissue.any() else 0.0
    inside = {
        "air inside": (empty & ~outside, -1),
        "dense part": (_opened(tissue & (hu > middle + CONTRAST_HU)), 1),
        "light part": (_opened(tissue & (hu < middle - CONTRAST_HU)), -1),
    }
    for kind, (voxels, sign) in inside.items():
        labels, count = ndimage.label(voxels)
        largest = np.argsort(-np.bincount(labels.ravel())[1:])[: MOST_PARTS_OF_KIND - 1] + 1
        parts += [(f"{kind} {rank}", labels == one, sign) for rank, one in enumerate(largest, 1)]
        if count > len(largest):
            parts.append((f"{kind} {MOST_PARTS_OF_KIND}", (labels > 0) & ~np.isin(labels, largest), sign))
    for name, part, sign in parts:
        near = ndimage.binary_dilation(part, iterations=SURFACE_REACH)
        near &= ndimage.binary_dilation(~part, iterations=SURFACE_REACH)
        if near.any():
            found[name] = sign * np.where(near, steep, 0)
            steep = np.where(near, 0, steep)
    return found


def _outside(empty: np.ndarray) -> np.ndarray:
    """Return the empty voxels around the object: those connected to a side of the volume."""
    labels, _ = ndimage.label(empty)
    border = np.concatenate([np.take(labels, end, axis).ravel() for axis in (1, 2) for end in (0, -1)])
    return np.isin(labels, np.setdiff1d(border, 0))


def _opened(voxels: np.ndarray) -> np.ndarray:
    """Return voxels without parts of one voxel's width; the volume continues beyond its first and last slice."""
    return ndimage.binary_opening(np.pad(voxels, ((1, 1), (0, 0), (0, 0)), mode="edge"))[1:-1]


def _slopes(
    values: np.ndarray, spacing_mm: tuple[float, float, float]
) -> tuple[list[int], list[np.ndarray], np.ndarray]:
    """Return the axes with more than one voxel, the slopes along them, and the length of the gradient.

    Values continue beyond the volume. One-sided differences at its ends would count surfaces there twice.
    """
    axes, slopes = [axis for axis in range(3) if values.shape[axis] > 1], []
    for axis in axes:
        ends = [(int(axis == other),) * 2 for other in range(3)]
        wide = np.gradient(np.pad(values, ends, mode="edge"), spacing_mm[axis], axis=axis)
        slopes.append(np.take(wide, range(1, wide.shape[axis] - 1), axis).astype(np.float32))
    return axes, slopes, np.sqrt(sum(slope**2 for slope in slopes))
