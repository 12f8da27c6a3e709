"""Errors of the stated object: density of each material, HU of a phantom, and location of edges.

Each error is a nuisance parameter with a Gaussian prior that changes the line integrals linearly. Its change per unit
is computed once, at the expected location of the object, so that fits need no further projection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from scipy import ndimage

from ...base.errors import InputError, did_you_mean
from ...base.geometry import ScanGeometry
from ...base.lru_cache import LRUCache
from ...base.pose import IN_PLACE, Pose
from ...base.units import HU_AIR
from ...io.volumes import Volume, read_nifti
from ...physics.beam.materials import Material
from ...physics.scenes.sampling import average_rays, supersampled
from ...physics.scenes.scene import GridScene, Scene, VoxelScene
from ...physics.scenes.shapes import NOTHING, ShapesScene
from ..fitting.nuisance import Nuisance
from ..noise.condensed import Observed
from ..request import DiagnosisRequest
from ..settings import ObjectUncertainty

DENSITY, SURFACE, HU = "density_of_", "surface_of_", "hu_near_"  # prefixes of names of parameters
SURFACE_VOXELS = 0.25  # additional SD of surfaces of voxels that have one material or none, or HU, in voxels
STEP_MM = 0.05  # growth of shapes for derivatives
# HU at which the error of a phantom in HU is a parameter; linear between them. Soft tissues differ by 20 HU or more.
NODES_HU = (-1000, -700, -300, -100, -50, 0, 25, 50, 75, 100, 150, 250, 500, 1000, 2000)
DENSE_HU = 150  # from here on the relative error of the density adds to the error in HU
EMPTY_HU = -500  # below it is air; the surface of the body is halfway between soft tissue and air
CONTRAST_HU = 40  # of parts within the body, from its median
# Parts of a phantom whose surfaces move on their own: the two largest ones of each kind, and all others together.
MOST_PARTS_OF_KIND, SURFACE_REACH = 3, 2  # voxels from a part, in which edges belong to it
# Changes of the line integrals of voxels, from one scene to another, and their amplitude, mean and standard deviation.
# - edge_blur: by a blur of sharp edges with a variance of half a squared voxel.
# - sharp_edges: by sharp interfaces within voxels; 0 for an object with blurred edges.
EDGES = {
    "edge_blur": ("sharp", "blurred", -0.25, 0.5),
    "sharp_edges": ("told", "sharp", 0.5, 0.5),
}
PARTS_PER_PIXEL, MOST_PARTS, ROUNDING = 3, 4, 1e-6  # parts of voxels, a third of a pixel wide at the isocenter
MOST_VOXELS = 5e7  # of a divided object, with 20 bytes each
# Variance of the attenuation in a voxel that remains unknown, relative to that of its mixture (GridScene.variance).
# - of labels: the mixture is that of an edge at a uniformly distributed position. Neighbors share this position where
#   a surface is parallel to the grid, so twice the variance is needed. With 1, view_blur stood out in two of three
#   scans with voxels of half a pixel (seed 102).
# - of shares: the position follows from the share and its gradient. Measured for random bodies: 0.011 to 0.019 (seed
#   102); with 1/60, scatter stood out in two of five scans with voxels of half a pixel.
UNKNOWN_OF_LABELS, UNKNOWN_OF_SHARES = 2.0, 1 / 30
EDGE_SHARE = 0.01  # of the largest variance by unknown edges, above which correlations of rays are estimated
LEAST_CORRELATION = 0.1  # up to this correlation, neighbors vary together
KEPT = 3  # changes: whitened of the fitted and of the held-out data, and for the latest values
KEPT_EDGES = 4  # poses


class Edges:
    """Changes of the line integrals of voxels by sharp edges of the object, and their unknown part.

    Parameters
    ----------
    shares : bool
        Whether amounts of the scene are shares of voxels; otherwise it is a phantom in HU.
    """

    def __init__(self, scene: GridScene, shares: bool, geometry: ScanGeometry, samples: int):
        self._geometry, self._samples, self._kept = geometry, samples, LRUCache(KEPT_EDGES)
        parts = parts_of_voxels(scene, geometry)
        binary = shares and scene.is_binary
        self.names = tuple(EDGES) if binary or max(parts) > 1 else ("edge_blur",)
        best = scene.with_partial_volumes() if binary else scene
        sharp = best.attenuation(parts, shares)
        self._scenes = {
            "told": scene.attenuation(),
            "sharp": sharp,
            "blurred": sharp.blurred(),
            "variance": scene.variance(shares),
        }
        # Errors of voxels along a ray are independent, so their variances add with squared path lengths.
        self._unknown = scene.grid.spacing[2] * (UNKNOWN_OF_LABELS if binary else UNKNOWN_OF_SHARES)

    def at(self, pose: Pose) -> dict[str, np.ndarray]:
        """Return the changes of EDGES, shape (views, rows, columns)."""

        def make() -> dict[str, np.ndarray]:
            ends = {name: EDGES[name][:2] for name in self.names}
            lines = {scene: self._lines(scene, pose) for scene in dict.fromkeys(chain.from_iterable(ends.values()))}
            return {name: lines[end] - lines[start] for name, (start, end) in ends.items()}

        return self._kept.get(pose, make)

    def unknown(self, pose: Pose) -> np.ndarray:
        """Return the standard deviation of line integrals by what is unknown of the edges.

        Neighboring rays share errors. Weights of rays count them as independent, so the variance is multiplied by the
        number of rays that vary together, which the change by sharp edges shows.
        """
        variance = self._unknown * self._lines("variance", pose)
        change = self.at(pose)["sharp_edges" if "sharp_edges" in self.names else "edge_blur"]
        there = variance > EDGE_SHARE * variance.max()
        scaled = np.divide(change, np.sqrt(variance), out=np.zeros_like(variance), where=there)
        return np.sqrt(variance * np.prod([together(scaled, axis) for axis in range(3)]))

    def _lines(self, name: str, pose: Pose) -> np.ndarray:
        return _lengths(self._scenes[name], self._geometry, self._samples, pose)[0]


@dataclass(frozen=True)
class ObjectErrors:
    """Errors of the stated object.

    Attributes
    ----------
    numbers : tuple of Nuisance
        One for each error of a density or HU.
    changes : ndarray of float32, shape (numbers, views, rows, columns)
        Change of line integrals per unit.
    edges : Edges or None
        Edges of voxels, whose changes are fitted as numerical distortions.
    stated : StatedObject or None
        Object, for the same errors in another scan.
    """

    numbers: tuple[Nuisance, ...] = ()
    changes: np.ndarray = field(default_factory=lambda: np.zeros((0, 1, 1, 1), np.float32))
    edges: Edges | None = None
    stated: StatedObject | None = None
    _kept: LRUCache = field(default_factory=lambda: LRUCache(KEPT), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(number.name for number in self.numbers)

    @property
    def edge_numbers(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters of the edges."""
        return tuple(Nuisance(name, "1", *EDGES[name][2:]) for name in (self.edges.names if self.edges else ()))

    def of_edges(self) -> ObjectErrors:
        """Return the errors of the edges alone."""
        return ObjectErrors(edges=self.edges)

    def whitened(self, data: Observed) -> np.ndarray:
        """Return the whitened changes, shape (numbers, data)."""

        def make() -> tuple[Observed, np.ndarray]:  # the key is valid while the data are in the cache
            columns = [data.whitened(np.where(data.usable, change, 0)).ravel() for change in self.changes]
            return data, np.stack(columns) if columns else np.zeros((0, data.mean.size))

        return self._kept.get(id(data), make)[1]

    def lines(self, nuisance: Mapping[str, float]) -> np.ndarray:
        """Return the change of the line integrals, shape (views, rows, columns)."""
        values = tuple(nuisance[name] for name in self.names)
        return self._kept.get(values, lambda: np.tensordot(values, self.changes, 1))


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

    @classmethod
    def of(cls, request: DiagnosisRequest, scene: Scene) -> StatedObject | None:
        """Return the object of a request; None if it is known exactly, or described by a simulation."""
        settings = request.settings
        if settings.object_exact or settings.simulation is not None:
            return None
        phantom = read_nifti(request.phantom) if settings.of_phantom else None
        return cls(scene, settings.object_uncertainty, request.mu_water_per_mm, phantom)

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
        return ObjectErrors(*self.amounts(geometry, samples, pose), self._edges(geometry, samples), self)

    @property
    def alignment(self) -> dict[str, float]:
        """Standard deviation of the size of a homogeneous object, and of a phantom in HU.

        Changes by surfaces are linear. For a surface of a phantom that is wrong by 0.28 pixels, they leave a difference
        like that of a wrong source distance (log score 17), unless the size is uncertain, too (0.4).
        """
        if self.phantom is None and not self._is_homogeneous:
            return {}
        return {"size": self._surface_mm / self.scene.radius_mm}

    @property
    def _is_homogeneous(self) -> bool:
        """Whether the object has one material and no shape of a hole."""
        return len(self.scene.materials) == 1 and NOTHING not in self._of_surfaces

    @property
    def _of_surfaces(self) -> list[Material]:
        """Materials whose surfaces are uncertain; shapes of holes are one of them."""
        shapes = self.scene.shapes if isinstance(self.scene, ShapesScene) else ()
        holes = any(shape.material == NOTHING for shape in shapes)
        return [*self.scene.materials, *([NOTHING] if holes else [])]

    @property
    def _surface_mm(self) -> float:
        """Standard deviation of the location of surfaces, mm."""
        surface_mm = self.uncertainty.surface_mm
        if self.phantom is not None or (isinstance(self.scene, GridScene) and self.scene.is_binary):
            surface_mm = float(np.hypot(surface_mm, SURFACE_VOXELS * self.scene.grid.spacing[2]))
        return surface_mm

    def another(self, scene: Scene) -> StatedObject:
        """Return another object, with default uncertainty of its materials."""
        return StatedObject(scene, ObjectUncertainty(), self.mu_water_per_mm)

    def _edges(self, geometry: ScanGeometry, samples: int) -> Edges | None:
        """Return the edges of voxels; None for shapes, and for a phantom in HU with small voxels."""
        fine = self.phantom is not None and max(parts_of_voxels(self.scene, geometry)) == 1
        if fine or not isinstance(self.scene, GridScene):
            return None
        return Edges(self.scene, self.phantom is None, geometry, samples)

    def amounts(self, geometry: ScanGeometry, samples: int, pose: Pose) -> tuple[tuple[Nuisance, ...], np.ndarray]:
        """Return the errors of densities or HU, and their changes."""
        if self.phantom is not None:
            scene, numbers = self._errors_of_phantom()
            per_mm = np.float32(self.mu_water_per_mm / 1000)
            return tuple(numbers), per_mm * _lengths(scene, geometry, samples, pose)
        if not self._is_homogeneous:  # whose density and size are those of the alignment
            return self._of_materials(geometry, samples, pose)
        return (), np.zeros((0, *geometry.shape), np.float32)

    def _of_materials(
        self, geometry: ScanGeometry, samples: int, pose: Pose
    ) -> tuple[tuple[Nuisance, ...], np.ndarray]:
        """Return the errors of density and surface of each material, and their changes."""
        scene, uncertainty = self.scene, self.uncertainty
        names, mu = list(map(str, scene.materials)), scene.attenuation_per_mm[:, None, None, None].astype(np.float32)
        densities = [Nuisance(DENSITY + name, "1", 0.0, uncertainty.density_of(name)) for name in names]
        surfaces = [Nuisance(f"{SURFACE}{of}", "mm", 0.0, self._surface_mm) for of in self._of_surfaces]
        lengths = _lengths(scene, geometry, samples, pose)
        if isinstance(scene, ShapesScene):
            grown = (scene.grown(material, STEP_MM) for material in self._of_surfaces)
            steps = [(_lengths(other, geometry, samples, pose) - lengths) / STEP_MM for other in grown]
            growth = np.stack([(mu * step).sum(axis=0) for step in steps])
        else:
            growth = _lengths(scene.growth(), geometry, samples, pose)
        return (*densities, *surfaces), np.concatenate([mu * lengths, growth])

    def _errors_of_phantom(self) -> tuple[Scene, list[Nuisance]]:
        """Return a scene with the change of the phantom, 1000 times relative to water, per unit of each parameter."""
        hu, scene = self.phantom.array, self.scene
        shares = np.stack([np.interp(hu, NODES_HU, tent).astype(np.float32) for tent in np.eye(len(NODES_HU))[1:]])
        nodes, there = np.array(NODES_HU[1:]), shares.any(axis=(1, 2, 3))
        density = self.uncertainty.density * np.where(nodes > DENSE_HU, nodes + 1000, 0)
        sds = np.hypot(self.uncertainty.hu, density)[there]
        numbers = [Nuisance(f"{HU}{node}", "HU", 0.0, float(sd)) for node, sd in zip(nodes[there], sds, strict=True)]
        surfaces = growth_of_parts(hu, self.phantom.grid.spacing)
        numbers += [Nuisance(SURFACE + name, "mm", 0.0, self._surface_mm) for name in surfaces]
        changes = np.concatenate([shares[there], *(change[None] for change in surfaces.values())])
        materials = ("water",) * len(numbers)
        return VoxelScene(changes, self.phantom.grid, materials, scene.energy_kev, scene.threads), numbers


def growth_of_parts(hu: np.ndarray, spacing_mm: tuple[float, float, float]) -> dict[str, np.ndarray]:
    """Return the change of a phantom if the surface of a part grows, HU/mm, by name of the part.

    Parts are the body, air within it, and parts of another density. Other edges are left to the errors of HU.
    """
    axes = [axis for axis in range(3) if hu.shape[axis] > 1]
    slopes = np.gradient(np.maximum(hu, HU_AIR), *(spacing_mm[axis] for axis in axes), axis=axes)
    steep = np.sqrt(sum(slope**2 for slope in (slopes if len(axes) > 1 else [slopes]))).astype(np.float32)
    empty, _ = ndimage.label(hu < EMPTY_HU)
    border = np.concatenate([np.take(empty, end, axis).ravel() for axis in (1, 2) for end in (0, -1)])
    outside = np.isin(empty, np.setdiff1d(border, 0))
    parts, found = [("body", ~outside, 1)], {}
    tissue = ~ndimage.binary_dilation(empty > 0, iterations=SURFACE_REACH)
    middle = float(np.median(hu[tissue])) if tissue.any() else 0.0
    inside = {
        "air inside": ((empty > 0) & ~outside, -1),
        "dense part": (ndimage.binary_opening(tissue & (hu > middle + CONTRAST_HU)), 1),
        "light part": (ndimage.binary_opening(tissue & (hu < middle - CONTRAST_HU)), -1),
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


def parts_of_voxels(scene: GridScene, geometry: ScanGeometry) -> tuple[int, int, int]:
    """Return the parts along z, y and x into which voxels are divided to show sharp edges."""
    pixel = np.array([geometry.row_pitch_mm, *2 * (geometry.column_pitch_mm,)]) / geometry.magnification
    shape = np.array(scene.grid.shape)
    most = min(MOST_PARTS, max(1, int((MOST_VOXELS / shape.prod()) ** (1 / (shape > 1).sum()))))
    parts = np.ceil(PARTS_PER_PIXEL * np.array(scene.grid.spacing) / pixel - ROUNDING).clip(1, most)
    return tuple(np.where(shape > 1, parts, 1).astype(int).tolist())


def together(values: np.ndarray, axis: int) -> float:
    """Return the number of neighbors along an axis that vary together: the variance of a mean, times their number."""
    values, length = np.moveaxis(values, axis, 0), values.shape[axis]
    square, total = float((values**2).sum()) / length, 0.0
    for lag in range(1, length):
        product = float((values[:-lag] * values[lag:]).sum()) / length
        if product < LEAST_CORRELATION * square:
            break
        total += product
    return 1 + 2 * total / square if square else 1.0


def words_of(name: str, error: float) -> str:
    """Return an error of the object in words."""
    denser = "denser" if error > 0 else "less dense"
    if name.startswith(HU):
        return f"voxels near {name.removeprefix(HU)} HU that are {abs(error):.2g} HU {denser} than stated"
    if name.startswith(SURFACE):
        larger, of = "larger" if error > 0 else "smaller", name.removeprefix(SURFACE)
        return f"{'holes' if of == NOTHING else of} with a surface that is {abs(error):.2g} mm {larger} than stated"
    return f"{name.removeprefix(DENSITY)} that is {100 * abs(error):.2g} % {denser} than stated"


def _lengths(scene: Scene, geometry: ScanGeometry, samples: int, pose: Pose) -> np.ndarray:
    """Return mean path lengths of the rays of each pixel, mm, float32, shape (materials, views, rows, columns)."""
    return sum(
        average_rays(scene.path_lengths(rays, pose), weights).astype(np.float32)
        for rays, weights in supersampled(geometry, samples)
    )
