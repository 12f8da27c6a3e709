"""Errors of the stated object: density of each material, HU of a phantom, and location of edges.

Each error is a nuisance parameter with a Gaussian prior that changes the line integrals linearly. Its change per unit
is computed where a first fit puts the object and its surfaces, so that later fits need no further projection.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np

from ...base.errors import InputError, did_you_mean
from ...base.geometry import ScanGeometry
from ...base.lru_cache import LRUCache
from ...base.pose import IN_PLACE, Pose
from ...base.units import HU_AIR
from ...io.volumes import Volume, read_nifti
from ...physics.beam.materials import Material
from ...physics.scenes.interfaces import sharpened
from ...physics.scenes.sampling import average_rays, supersampled
from ...physics.scenes.scene import GridScene, Scene, VoxelScene
from ...physics.scenes.shapes import NOTHING, Shape, ShapesScene
from ..fitting.nuisance import Nuisance
from ..noise.condensed import Observed
from ..request import DiagnosisRequest
from ..settings import ObjectUncertainty
from .voxel_surfaces import LabelSurfaces, Part, VoxelSurfaces, growth_of, growth_of_parts, labelled_parts, own_surfaces

DENSITY, SURFACE, HU = "density_of_", "surface_of_", "hu_near_"  # prefixes of names of parameters
SURFACE_VOXELS = 0.25  # additional SD of surfaces of voxels that have one material or none, or HU, in voxels
# Growth of shapes for derivatives; with 0.05, surfaces converge more slowly. Errors of surfaces that move less are not
# linearized again: chi-square would change by 0.1 (preparation.CONVERGED).
STEP_MM = 0.005
MOST_PARTS_WITH_ERRORS = 12  # shapes or parts of labels that have errors of their own; otherwise each material
# HU at which the error of a phantom in HU is a parameter; linear between them. Soft tissues differ by 20 HU or more.
NODES_HU = (-1000, -700, -300, -100, -50, 0, 25, 50, 75, 100, 150, 250, 500, 1000, 2000)
DENSE_HU = 150  # from here on the relative error of the density adds to the error in HU
# Changes of the line integrals of voxels, from one scene to another, and their amplitude, mean and standard deviation.
# - edge_blur: by a blur of sharp edges with a variance of half a squared voxel.
# - sharp_edges: by sharp interfaces within voxels; 0 for an object with blurred edges.
# - finer_edges: the same for an object whose fitted scene has the surfaces of labels.
EDGE_BLUR, SHARP_EDGES, FINER_EDGES = "edge_blur", "sharp_edges", "finer_edges"
EDGES = {
    EDGE_BLUR: ("sharp", "blurred", -0.25, 0.5),
    SHARP_EDGES: ("fitted", "sharp", 0.5, 0.5),
    FINER_EDGES: ("fitted", "sharp", 1.0, 0.5),
}
# Parts of voxels, a third of a pixel wide at the isocenter; those of labels half as wide in the plane. In a bench
# object with voxels of a third of a pixel, line integrals are then wrong by 0.0008 (RMS), else by 0.0015.
PARTS_PER_PIXEL, PARTS_PER_PIXEL_OF_LABELS = (3, 3, 3), (3, 6, 6)
# Rays per pixel along the columns for changes at edges of voxels. With 2, line integrals at the edge of a disc had
# errors of up to 0.009 (RMS), equal in all views if it is centered. Fitted source distances were up to ten standard
# deviations off. With 8, errors are 0.002, as with 16.
EDGE_RAYS = 8
MOST_PARTS, WIDER = 4, 0.1  # a part may be wider by this share, so that a fitted magnification changes nothing
MOST_VOXELS = 5e7  # of a divided object, with 20 bytes each
# Variance of the attenuation in a voxel of shares or HU that remains unknown, relative to GridScene.variance. (Labels
# have label_surfaces.UNKNOWN.) The position of an edge follows from the share and its gradient. Measured for random
# bodies: 0.011 to 0.019 (seed 102); with 1/60, scatter stood out in two of five scans with voxels of half a pixel.
UNKNOWN_OF_SHARES = 1 / 30
# Error of the change of line integrals by surfaces of voxels, relative to the change and to the size of a voxel in
# pixels. Measured for discs of 60 and 100 mm with voxels of 0.4 to 0.7 pixels that grow by -0.3 to 0.2 mm: 0.12 to
# 0.30. The volume of the grown disc has 0.13 to 0.26.
SURFACES_LEFT = 0.25
# The same for labels, whose surfaces move exactly: 0.02 to 0.16 for discs with radii of 8 to 70 voxels that grow by
# -0.6 to 0.6 voxels (seed 8), the least for large changes.
SURFACES_LEFT_OF_LABELS = 0.1
OPAQUE = 50.0  # largest line integral whose transmission is computed: single precision ends at 87
EDGE_SHARE = 0.01  # of the largest variance by unknown edges, above which correlations of rays are estimated
LEAST_CORRELATION = 0.1  # up to this correlation, neighbors vary together
CACHED_CHANGES = 3  # whitened changes of the fitted and of the held-out data, and for the latest values
CACHED_POSES = 4  # changes at edges, each for one pose


@dataclass(frozen=True)
class EdgeScenes:
    """Scenes whose line integrals differ by the edges of an object of voxels.

    Attributes
    ----------
    names : tuple of str
        Changes that the object has, keys of EDGES.
    scenes : dict of str to GridScene
        By name: attenuation or, for "variance", its unknown part.
    unknown_mm : float
        Length whose product with the sum of "variance" along a ray is the variance of a line integral. Errors of voxels
        along a ray are independent, so that their variances add with squared path lengths.
    """

    names: tuple[str, ...]
    scenes: dict[str, GridScene]
    unknown_mm: float

    @classmethod
    def of(
        cls,
        scene: GridScene,
        fitted: GridScene,
        best: GridScene,
        rough: GridScene,
        shares: bool,
        parts: tuple[int, int, int],
    ) -> EdgeScenes:
        """Return the scenes of an object.

        Parameters
        ----------
        scene : GridScene
            The stated object.
        fitted : GridScene
            Scene to whose line integrals the changes are added.
        best, rough : GridScene
            The scene with partial volumes; of labels, by curves and from smoothed voxels alone.
        shares : bool
            Whether amounts of the scene are shares of voxels; otherwise it is a phantom in HU.
        parts : tuple of 3 int
            Parts of a voxel (parts_of_voxels).
        """
        binary = shares and scene.is_binary
        divided, terraced = max(parts) > 1, binary and fitted is scene
        sharper = SHARP_EDGES if fitted is scene else FINER_EDGES
        sharp = best.attenuation(parts, shares)
        blurred = sharp.blurred()
        scenes = {
            "stated": scene.attenuation(),
            "fitted": fitted.attenuation(),
            "sharp": sharp,
            "blurred": blurred,
            "variance": unknown_variance(scene, best) if binary else scene.variance(shares),
            # Its difference from the stated scene shows the extent of errors of edges.
            "rough": rough.attenuation() if binary else sharp if divided else blurred,
        }
        names = (EDGE_BLUR, sharper) if divided or terraced else (EDGE_BLUR,)
        return cls(names, scenes, scene.grid.spacing[2] * (1.0 if binary else UNKNOWN_OF_SHARES))


class Edges:
    """Changes of the line integrals of voxels by sharp edges of the object, and their unknown part."""

    def __init__(self, of_object: EdgeScenes, geometry: ScanGeometry, samples: int):
        self._object, self._geometry, self._samples = of_object, geometry, samples
        self._cache = LRUCache(CACHED_POSES)

    @property
    def names(self) -> tuple[str, ...]:
        """As EdgeScenes.names."""
        return self._object.names

    def at(self, pose: Pose) -> dict[str, np.ndarray]:
        """Return the changes of EDGES, shape (views, rows, columns)."""

        def make() -> dict[str, np.ndarray]:
            ends = {name: EDGES[name][:2] for name in self.names}
            passed = {scene: self._mean_transmission(scene, pose) for scene in {*chain.from_iterable(ends.values())}}
            return {name: np.log(passed[start] / passed[end]) for name, (start, end) in ends.items()}

        return self._cache.get(pose, make)

    def unknown(self, pose: Pose) -> np.ndarray:
        """Return the standard deviation of line integrals by the unknown part of the edges.

        Neighboring rays share errors. Weights of rays count them as independent, so the variance is multiplied by the
        number of rays that vary together, which the change by sharp edges shows.
        """
        variance = self._object.unknown_mm * self._lines("variance", pose)
        change = self._lines("rough", pose) - self._lines("stated", pose)
        there = variance > EDGE_SHARE * variance.max()
        scaled = np.divide(change, np.sqrt(variance), out=np.zeros_like(variance), where=there)
        return np.sqrt(variance * np.prod([together(scaled, axis) for axis in range(3)]))

    def _lines(self, name: str, pose: Pose) -> np.ndarray:
        return _lengths(self._object.scenes[name], self._geometry, self._samples, pose)[0]

    def _mean_transmission(self, name: str, pose: Pose) -> np.ndarray:
        """Return the mean transmission of the rays of each pixel."""

        def of_rays(rays: ScanGeometry) -> np.ndarray:
            return _transmission(self._object.scenes[name].path_lengths(rays, pose)[0])

        return _over_pixels(of_rays, self._geometry, self._samples, finely=True).astype(np.float32)


def unknown_variance(labels: GridScene, best: GridScene) -> GridScene:
    """Return GridScene.variance of labels with only the part that their partial volumes leave unknown."""
    margin = [((wide - n) // 2,) * 2 for wide, n in zip(best.grid.shape, labels.grid.shape, strict=True)]
    variance = labels.with_amounts(np.pad(labels.amounts, [(0, 0), *margin])).variance()
    more = [((wide - n) // 2,) * 2 for wide, n in zip(variance.grid.shape, best.grid.shape, strict=True)]
    return variance.with_amounts(variance.amounts * np.pad(best.surfaces.unknown_field, more, mode="edge"))


@dataclass(frozen=True)
class ObjectErrors:
    """Errors of the stated object.

    Attributes
    ----------
    numbers : tuple of Nuisance
        One for each error of a density or HU.
    changes : ndarray of float32, shape (numbers, views, rows, columns)
        Change of line integrals per unit.
    constant : ndarray or float
        Change of line integrals that is added, so that line integrals of StatedObject.with_surfaces become exact where
        they were linearized.
    left : ndarray or float
        Standard deviation of the error of line integrals that remains, because voxels do not show where a surface is.
    edges : Edges or None
        Edges of voxels, whose changes are fitted as numerical distortions.
    stated : StatedObject or None
        Object, for the same errors in another scan.
    """

    numbers: tuple[Nuisance, ...] = ()
    changes: np.ndarray = field(default_factory=lambda: np.zeros((0, 1, 1, 1), np.float32))
    constant: np.ndarray | float = 0.0
    left: np.ndarray | float = 0.0
    edges: Edges | None = None
    stated: StatedObject | None = None
    _cache: LRUCache = field(default_factory=lambda: LRUCache(CACHED_CHANGES), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(number.name for number in self.numbers)

    @property
    def edge_numbers(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters of the edges."""
        return tuple(Nuisance(name, "1", *EDGES[name][2:]) for name in (self.edges.names if self.edges else ()))

    def remaining(self, pose: Pose) -> tuple[np.ndarray, ...]:
        """Return the standard deviations of errors that no parameter describes, shape (views, rows, columns)."""
        left = (self.left,) if np.any(self.left) else ()
        return left if self.edges is None else (*left, self.edges.unknown(pose))

    def of_edges(self) -> ObjectErrors:
        """Return the errors of the edges alone."""
        return ObjectErrors(edges=self.edges)

    def whitened(self, data: Observed) -> np.ndarray:
        """Return the whitened changes, shape (numbers, data)."""

        def make() -> tuple[Observed, np.ndarray]:  # the key is valid while the data are in the cache
            columns = [data.whitened(change).ravel() for change in self.changes]
            return data, np.stack(columns) if columns else np.zeros((0, data.mean.size))

        return self._cache.get(id(data), make)[1]

    def lines(self, nuisance: Mapping[str, float]) -> np.ndarray:
        """Return the change of the line integrals, shape (views, rows, columns)."""
        values = tuple(nuisance[name] for name in self.names)
        return self._cache.get(values, lambda: np.tensordot(values, self.changes, 1) + self.constant)


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
    _cache: LRUCache = field(default_factory=lambda: LRUCache(1), repr=False)
    _edges_of_scene: LRUCache = field(default_factory=lambda: LRUCache(1), repr=False)

    @classmethod
    def of(cls, request: DiagnosisRequest, scene: Scene) -> StatedObject | None:
        """Return the object of a request; None if it is known exactly, or described by images."""
        settings = request.settings
        if settings.object_exact or settings.simulation is not None or settings.of_scan:
            return None
        phantom = read_nifti(request.phantom) if settings.of_phantom else None
        return cls(scene, settings.object_uncertainty, request.mu_water_per_mm, phantom)

    def errors(
        self, geometry: ScanGeometry, samples: int, pose: Pose = IN_PLACE, about: Mapping[str, float] | None = None
    ) -> ObjectErrors:
        """Return the errors of the object in a scan with `samples` rays per pixel and direction.

        Parameters
        ----------
        about : mapping of str to float, optional
            Errors of the object about which its line integrals are linearized; 0 for errors without a value.

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
        found = self.errors_without_edges(geometry, samples, pose, about)
        return replace(found, edges=self._edges(geometry, samples, about), stated=self)

    @property
    def alignment(self) -> dict[str, float]:
        """Standard deviation of the size of a homogeneous object, which has no other error of its surface."""
        return {} if self.has_surfaces else {"size": self._surface_mm / self.scene.radius_mm}

    @cached_property
    def has_surfaces(self) -> bool:
        """Whether surfaces of parts are parameters: not for a homogeneous object without holes."""
        if self.phantom is not None or len(self.scene.materials) > 1:
            return True
        if isinstance(self.scene, ShapesScene):
            return any(shape.material == NOTHING for shape in self.scene.shapes)
        return self._of_binary_voxels and any(part.material == NOTHING for part in self._parts.values())

    @property
    def has_precise_surfaces(self) -> bool:
        """Whether the object has shapes or labels, whose surfaces are known to a small part of a voxel."""
        return isinstance(self.scene, ShapesScene) or self._of_binary_voxels

    @property
    def _of_binary_voxels(self) -> bool:
        """Whether each voxel has one material or none, which does not show where edges are."""
        return self.phantom is None and isinstance(self.scene, GridScene) and self.scene.is_binary

    @cached_property
    def _parts(self) -> dict[str, Part]:
        """Parts of voxels with materials."""
        return labelled_parts(self._best, MOST_PARTS_WITH_ERRORS)

    @property
    def _surface_mm(self) -> float:
        """Standard deviation of the location of surfaces, mm."""
        surface_mm = self.uncertainty.surface_mm
        if self.phantom is not None or self._of_binary_voxels:
            surface_mm = float(np.hypot(surface_mm, SURFACE_VOXELS * self.scene.grid.spacing[2]))
        return surface_mm

    def another(self, scene: Scene) -> StatedObject:
        """Return another object, with default uncertainty of its materials."""
        return StatedObject(scene, ObjectUncertainty(), self.mu_water_per_mm)

    def _edges(self, geometry: ScanGeometry, samples: int, about: Mapping[str, float] | None) -> Edges | None:
        """Return the edges of voxels; None for shapes, and for a phantom in HU with small voxels."""
        fine = self.phantom is not None and max(parts_of_voxels(self.scene, geometry)) == 1
        if fine or not isinstance(self.scene, GridScene):
            return None
        fitted = self.with_surfaces(about)
        key = geometry.key, samples, fitted is self.scene
        return self._cache.get(key, lambda: Edges(self._edge_scenes(fitted, geometry), geometry, samples))

    def _edge_scenes(self, fitted: GridScene, geometry: ScanGeometry) -> EdgeScenes:
        parts = parts_of_voxels(self.scene, geometry)

        def make() -> EdgeScenes:
            return EdgeScenes.of(self.scene, fitted, self._best, self._rough, self.phantom is None, parts)

        return self._edges_of_scene.get((parts, fitted is self.scene), make)

    @cached_property
    def _best(self) -> GridScene:
        """Scene of voxels with partial volumes; of materials with a margin, into which surfaces may grow."""
        scene = self.scene
        if self.phantom is not None:
            return scene
        if self._of_binary_voxels:
            return scene.with_partial_volumes()
        return scene.with_amounts(np.pad(scene.amounts, ((0, 0), (0, 0), (1, 1), (1, 1))))

    @cached_property
    def _rough(self) -> GridScene:
        """As _best, with surfaces of labels from smoothed voxels alone."""
        return self.scene.with_partial_volumes(contours=False) if self._of_binary_voxels else self._best

    @cached_property
    def _of_volumes(self) -> tuple[dict[Nuisance, np.ndarray], VoxelSurfaces | LabelSurfaces]:
        """Change of the attenuation per unit of each error of a density or HU, 1/mm, and its surfaces."""
        return self._of_labels() if self.phantom is None else self._of_phantom()

    def with_surfaces(self, about: Mapping[str, float] | None) -> Scene:
        """Return the scene to which the changes of `errors` are added.

        A change of line integrals at an edge depends on all effects that move or blur it, which the scene of the chain
        takes into account. Shapes have the surfaces of `about`. Labels have surfaces if these fit better than the
        terraces of voxels, which any blur would smooth.
        """
        if not about:
            return self.scene
        if self._of_binary_voxels:
            has_surfaces = EDGE_BLUR in about and SHARP_EDGES not in about
            fits_better = about.get(SHARP_EDGES, 0.0) > EDGES[SHARP_EDGES][2]
            return self._best if has_surfaces or fits_better else self.scene
        if not isinstance(self.scene, ShapesScene) or not self.has_surfaces:
            return self.scene
        parts = parts_of_shapes(self.scene.shapes)
        return _grown(self.scene, parts, {name: about.get(SURFACE + name, 0.0) for name in parts})

    def errors_without_edges(
        self, geometry: ScanGeometry, samples: int, pose: Pose, about: Mapping[str, float] | None = None
    ) -> ObjectErrors:
        """Return the errors of densities or HU and of surfaces; arguments as in `errors`."""
        if not self.has_surfaces:  # density and size are parameters of the alignment
            return ObjectErrors()
        if isinstance(self.scene, ShapesScene):
            return self._of_shapes(geometry, samples, pose, about or {})
        return self._of_grid(geometry, samples, pose, about or {})

    def _of_shapes(self, geometry: ScanGeometry, samples: int, pose: Pose, about: Mapping[str, float]) -> ObjectErrors:
        """Return the errors of the density and the surface of each shape."""
        scene, parts = self.scene, parts_of_shapes(self.scene.shapes)
        of_shape = {index: name for name, indices in parts.items() for index in indices}
        material = {name: scene.shapes[indices[0]].material for name, indices in parts.items()}
        # A scene with the parts in place of materials, for the path length in each of them.
        shapes = [
            shape if shape.material == NOTHING else replace(shape, material=of_shape[index])
            for index, shape in enumerate(scene.shapes)
        ]
        divided = ShapesScene(shapes, scene.energy_kev, scene.threads)
        listed = dict(zip(scene.materials, scene.attenuation_per_mm, strict=True))
        mu = np.array([listed[material[name]] for name in divided.materials])
        sds = [self.uncertainty.density_of(str(material[name])) for name in divided.materials]
        densities = [Nuisance(DENSITY + name, "1", 0.0, sd) for name, sd in zip(divided.materials, sds, strict=True)]
        surfaces = [Nuisance(SURFACE + name, "mm", 0.0, self._surface_mm) for name in parts]
        grown = {name: about.get(SURFACE + name, 0.0) for name in parts}
        denser = mu * (1 + np.array([about.get(number.name, 0.0) for number in densities]))

        def lines(by: Mapping[str, float], attenuation: np.ndarray) -> np.ndarray:
            """Return line integrals as a detector measures them, from the mean transmission of the rays of a pixel.

            `attenuation` has the shape (..., materials), line integrals (..., views, rows, columns).
            """

            def transmitted(paths: np.ndarray) -> np.ndarray:
                return _transmission(np.tensordot(attenuation, paths, 1))

            return -np.log(_mean(transmitted, _grown(divided, parts, by), geometry, samples, pose))

        # Line integrals of `with_surfaces` include the grown surfaces, but not the errors of densities.
        here, with_surfaces = lines(grown, np.stack([denser, mu]))
        steps = [grown | {name: grown[name] + STEP_MM} for name in parts]
        growth = np.stack([(lines(step, denser) - here) / STEP_MM for step in steps])
        through = mu[:, None, None, None] * _lengths(_grown(divided, parts, grown), geometry, samples, pose)
        changes = np.concatenate([through, growth]).astype(np.float32)
        values = [about.get(number.name, 0.0) for number in (*densities, *surfaces)]
        constant = here - with_surfaces - np.tensordot(values, changes, 1) if any(values) else 0.0
        return ObjectErrors((*densities, *surfaces), changes, constant)

    def _of_grid(self, geometry: ScanGeometry, samples: int, pose: Pose, about: Mapping[str, float]) -> ObjectErrors:
        """Return the errors of densities or HU and of surfaces of voxels."""
        errors, surfaces = self._of_volumes
        by_mm = {name: about.get(SURFACE + name, 0.0) for name in surfaces.names}
        moved = surfaces.grown(by_mm)
        numbers = (*errors, *(Nuisance(SURFACE + name, "mm", 0.0, self._surface_mm) for name in by_mm))

        def scene_of(volumes: np.ndarray) -> GridScene:
            if self.phantom is None:
                return self._best.with_amounts(volumes)
            names = ("water",) * len(volumes)
            return VoxelScene(volumes, self.phantom.grid, names, self.scene.energy_kev, self.scene.threads)

        changing = scene_of(np.stack([*errors.values(), *moved.growth.values()]))
        if isinstance(surfaces, LabelSurfaces):
            parts = parts_of_voxels(self.scene, geometry)
            sharp = (sharpened(one.attenuation, parts) for one in (moved, surfaces))
            ends, left = [self._best.with_amounts(values[None], parts) for values in sharp], SURFACES_LEFT_OF_LABELS
        else:
            ends, left = [scene_of(one.values[None]) for one in (moved, surfaces)], SURFACES_LEFT

        def transmitted(rays: ScanGeometry) -> np.ndarray:
            # A detector measures the mean transmission of the rays of a pixel.
            passed = np.concatenate([_transmission(end.path_lengths(rays, pose)) for end in ends])
            return np.concatenate([changing.path_lengths(rays, pose) * passed[0], passed])

        sums = _over_pixels(transmitted, geometry, samples, finely=True).astype(np.float32)
        changes = sums[:-2] / sums[-2]
        linear = np.tensordot(list(by_mm.values()), changes[len(errors) :], 1)
        change = np.log(sums[-1] / sums[-2])
        # Rows that see the same edge share the error; weights of rays count them as independent.
        share = left * surfaces.spacing_mm[2] * geometry.magnification / geometry.column_pitch_mm
        return ObjectErrors(numbers, changes, change - linear, share * np.sqrt(together(change, 1)) * np.abs(change))

    def _of_labels(self) -> tuple[dict[Nuisance, np.ndarray], VoxelSurfaces | LabelSurfaces]:
        best, spacing = self._best, self._best.grid.spacing
        mu = dict(zip(best.materials, best.attenuation_per_mm.astype(np.float32), strict=True))
        parts = self._parts
        densities = {
            Nuisance(DENSITY + name, "1", 0.0, self.uncertainty.density_of(str(part.material))): (
                mu[part.material] * part.share
            )
            for name, part in parts.items()
            if part.material != NOTHING
        }
        if best.surfaces is not None:
            return densities, LabelSurfaces.of(best, parts)
        total = np.tensordot(np.array(list(mu.values())), best.amounts, 1)
        own = own_surfaces(parts)
        growth = {name: own[name] * growth_of(part.share, total, spacing) for name, part in parts.items()}
        return densities, VoxelSurfaces(total, growth, spacing)

    def _of_phantom(self) -> tuple[dict[Nuisance, np.ndarray], VoxelSurfaces]:
        hu, per_hu = np.maximum(self.phantom.array, HU_AIR), np.float32(self.mu_water_per_mm / 1000)
        errors, spacing = {}, self.phantom.grid.spacing
        for node, tent in zip(NODES_HU[1:], np.eye(len(NODES_HU))[1:], strict=True):
            share = np.interp(self.phantom.array, NODES_HU, tent).astype(np.float32)
            density = self.uncertainty.density * (node + 1000) if node > DENSE_HU else 0.0
            if share.any():
                number = Nuisance(f"{HU}{node}", "HU", 0.0, float(np.hypot(self.uncertainty.hu, density)))
                errors[number] = per_hu * share
        growth = {name: per_hu * change for name, change in growth_of_parts(hu, spacing).items()}
        return errors, VoxelSurfaces(per_hu * (hu - HU_AIR), growth, spacing)


def parts_of_shapes(shapes: Sequence[Shape]) -> dict[str, list[int]]:
    """Return the indices of the shapes that have errors of their own, by name: single shapes, or all of a material."""
    of_material: dict[Material, list[int]] = {}
    for index, shape in enumerate(shapes):
        of_material.setdefault(shape.material, []).append(index)
    if len(shapes) > MOST_PARTS_WITH_ERRORS:
        return {str(material): indices for material, indices in of_material.items()}
    return {
        str(material) if len(indices) == 1 else f"{material} {number}": [index]
        for material, indices in of_material.items()
        for number, index in enumerate(indices, 1)
    }


def _grown(scene: ShapesScene, parts: Mapping[str, Sequence[int]], by_mm: Mapping[str, float]) -> ShapesScene:
    """Return the scene with the surfaces of its parts displaced outwards."""
    each = {index: by_mm[name] for name, indices in parts.items() for index in indices}
    return scene.grown([each[index] for index in range(len(each))])


def parts_of_voxels(scene: GridScene, geometry: ScanGeometry) -> tuple[int, int, int]:
    """Return the parts along z, y and x into which voxels are divided to show sharp edges."""
    pixel = np.array([geometry.row_pitch_mm, *2 * (geometry.column_pitch_mm,)]) / geometry.magnification
    shape = np.array(scene.grid.shape)
    most = min(MOST_PARTS, max(1, int((MOST_VOXELS / shape.prod()) ** (1 / (shape > 1).sum()))))
    wanted = np.array(PARTS_PER_PIXEL_OF_LABELS if scene.is_binary else PARTS_PER_PIXEL)
    parts = np.ceil(wanted * scene.grid.spacing / pixel - WIDER).clip(1, most)
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
        part = of.replace(NOTHING, "hole", 1) if of.startswith(NOTHING) else of
        return f"{part} with a surface that is {abs(error):.2g} mm {larger} than stated"
    return f"{name.removeprefix(DENSITY)} that is {100 * abs(error):.2g} % {denser} than stated"


def _transmission(line_integrals: np.ndarray) -> np.ndarray:
    """Return the transmission of rays; for opaque rays, the transmission of OPAQUE."""
    return np.exp(-np.minimum(line_integrals, OPAQUE))


def _lengths(scene: Scene, geometry: ScanGeometry, samples: int, pose: Pose) -> np.ndarray:
    """Return mean path lengths of the rays of each pixel, mm, float32, shape (materials, views, rows, columns)."""
    return _mean(lambda paths: paths, scene, geometry, samples, pose).astype(np.float32)


def _over_pixels(
    of_rays: Callable[[ScanGeometry], np.ndarray], geometry: ScanGeometry, samples: int, finely: bool = False
) -> np.ndarray:
    """Return the mean of a function of rays over each pixel, shape (..., views, rows, columns).

    Parameters
    ----------
    finely : bool, optional
        Whether columns have EDGE_RAYS, unless a single ray stands for a pixel.
    """
    of_columns = EDGE_RAYS if finely and samples > 1 else None
    return sum(average_rays(of_rays(rays), weights) for rays, weights in supersampled(geometry, samples, of_columns))


def _mean(
    function: Callable[[np.ndarray], np.ndarray], scene: Scene, geometry: ScanGeometry, samples: int, pose: Pose
) -> np.ndarray:
    """Return the mean of a function of path lengths over each pixel, shape (..., views, rows, columns)."""
    found = _over_pixels(lambda rays: function(scene.path_lengths(rays, pose)), geometry, samples)
    for edges in scene.edge_scans(geometry, samples, pose) if isinstance(scene, ShapesScene) else ():
        edges.replace_in(found, function(scene.path_lengths(edges, pose)))
    return found
