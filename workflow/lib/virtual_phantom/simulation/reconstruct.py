"""Reconstructed images, with the effects that act on them."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.geometry import Grid, ScanGeometry
from ..base.settings import FbpSettings, ImageSettings, SirtSettings
from ..base.units import rounded_hu
from ..io.volumes import Volume
from ..phantom import read_masks
from ..physics.effect import filter_factor, image_effects, load
from ..physics.image_state import ImageState
from ..reconstruction.boxes import Box, back_in_boxes, boxes_around, voxels_over, whole
from ..reconstruction.fbp import ParallelProjections
from ..reconstruction.images import filtered, filters_projections, reconstruct_hu


def apply_image_effects(
    hu: np.ndarray,
    spacing_mm: tuple[float, float, float],
    physics: Mapping[str, Mapping[str, float]],
    reconstructed: tuple[np.ndarray, np.ndarray] | tuple[()] = (),
) -> np.ndarray:
    """Apply effects of stage "image" in their order. Without effects the image itself is returned.

    Parameters
    ----------
    hu : ndarray, shape (z, y, x)
        HU.
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    physics : mapping of str to mapping of str to float
        {effect: {parameter: value}}.
    reconstructed : tuple of 2 ndarray, shape (z, y, x), optional
        ImageState.before_filter and after_filter.
    """
    if not physics:
        return hu
    state = ImageState(np.asarray(hu, np.float32), spacing_mm, *reconstructed)
    for name in sorted(physics, key=image_effects().index):
        load(name).apply(state, physics[name])
    return state.hu


def reconstruct(
    line_integrals: np.ndarray,
    geometry: ScanGeometry,
    grid: Grid,
    algorithm: str,
    settings: SirtSettings | FbpSettings,
    *,
    engine: str,
    mu_water_per_mm: float,
    physics: dict | None = None,
    threads: int = 1,
) -> list[Volume]:
    """Reconstruct one image per acquisition.

    Parameters
    ----------
    line_integrals : ndarray, shape (acquisitions, views, rows, columns)
    algorithm, settings, engine, mu_water_per_mm
        As reconstruction.images.reconstruct_hu takes them.
    physics : dict, optional
        Effects of stage "image", {effect: {parameter: value}}.

    Returns
    -------
    list of Volume
        int16 HU on `grid`.

    Raises
    ------
    InputError
        For an unknown algorithm or a scan that it cannot use.
    """

    def images(mtf=None):
        how = algorithm, settings, engine, mu_water_per_mm, threads
        return reconstruct_hu(line_integrals, geometry, grid, *how, mtf=mtf)

    mtf = filter_factor(physics or {}) if filters_projections(algorithm, settings) else None
    return _volumes(images(), grid, physics, None if mtf is None else images(mtf))


def back_project(
    projections: ParallelProjections,
    grid: Grid,
    boxes: Sequence[Box],
    *,
    mu_water_per_mm: float,
    thickness_mm: float | None = None,
    physics: Mapping[str, Mapping[str, float]] | None = None,
    with_filter: ParallelProjections | None = None,
    threads: int = 1,
) -> list[list[Volume]]:
    """Return images from filtered projections, with air outside of the boxes.

    Parameters
    ----------
    projections : ParallelProjections
        See reconstruction.images.filtered.
    boxes, mu_water_per_mm, thickness_mm
        As boxes.back_in_boxes takes them.
    physics : mapping, optional
        As `reconstruct` takes it.
    with_filter : ParallelProjections, optional
        The same, with the filter among `physics` (Effect.mtf).

    Returns
    -------
    list of list of Volume
        int16 HU on `grid`, for each filter one image per acquisition.
    """
    how = {"mu_water_per_mm": mu_water_per_mm, "thickness_mm": thickness_mm, "threads": threads}
    made = back_in_boxes(projections, grid, boxes, **how)
    after = [None] * len(made) if with_filter is None else back_in_boxes(with_filter, grid, boxes, **how)
    return [_volumes(hu, grid, physics, filtered_hu) for hu, filtered_hu in zip(made, after, strict=True)]


@dataclass(frozen=True)
class NoisyScans:
    """Noisy scans of a job, one for each realization.

    Attributes
    ----------
    line_integrals : ndarray, shape (realizations, views, rows, columns)
    geometries : list of ScanGeometry
    sources : list of str
        Names of the noise-free scans.
    noise_free : dict of str to ndarray
        {source: noise-free line integrals}, which a noise kernel needs.
    """

    line_integrals: np.ndarray
    geometries: list[ScanGeometry]
    sources: list[str]
    noise_free: dict[str, np.ndarray]


def reconstruct_images(
    images: Sequence[ImageSettings],
    scans: NoisyScans,
    grid: Grid,
    rois_files: Mapping[str, Sequence[str]],
    *,
    engine: str,
    mu_water_per_mm: float,
    threads: int = 1,
) -> Iterator[tuple[str, int, Volume]]:
    """Reconstruct all realizations of all protocols that share scans.

    Projections are filtered once for each kernel, for two kernels at a time. Images of both on the same voxels are
    back-projected together.

    Parameters
    ----------
    grid : Grid
        Voxels of images without voxels of their own.
    rois_files : mapping of str to sequence of str
        {protocol with its own voxels: table of ROIs of each realization}; only boxes around the ROIs are made.

    Yields
    ------
    protocol : str
    realization : int
    volume : Volume
        int16 HU.

    Raises
    ------
    InputError
        For an unknown algorithm or a scan that it cannot use.
    """
    common = {"mu_water_per_mm": mu_water_per_mm, "threads": threads}
    of_filter: dict[FbpSettings, list[ImageSettings]] = {}
    for image in images:
        if filters_projections(image.algorithm, image.settings):
            of_filter.setdefault(image.settings, []).append(image)
            continue
        for lanes in _equal(float(scan.angles_rad[0]) for scan in scans.geometries):
            scan = _some(scans.line_integrals, lanes), scans.geometries[lanes[0]], grid
            how = {"engine": engine, "physics": image.physics, **common}
            volumes = reconstruct(*scan, image.algorithm, image.settings, **how)
            yield from ((image.protocol, lane, volume) for lane, volume in zip(lanes, volumes, strict=True))
    # Projections of two filters are in memory at once. On a GPU, those of one filter and one lane save memory.
    at_once, keys = (2, scans.sources) if engine == "cpu" else (1, range(len(scans.sources)))
    filters = list(of_filter)
    for first in range(0, len(filters), at_once):
        some = {settings: of_filter[settings] for settings in filters[first : first + at_once]}
        for lanes in _equal(keys):
            yield from _filtered_images(some, scans, lanes, grid, rois_files, engine, common)


def _filtered_images(of_filter, scans, lanes, grid, rois_files, engine, common):
    """Yield images of some realizations and filters, as `reconstruct_images` does."""
    scan = _some(scans.line_integrals, lanes), scans.geometries[lanes[0]]
    clean, filters = scans.noise_free.get(scans.sources[lanes[0]]), list(of_filter)
    projections = filtered(*scan, filters, clean, engine)
    for which, alike in _pairs(list(of_filter.values()), rois_files):
        image, options = alike[0], {}
        if image.voxels is None:
            voxels, boxes = grid, whole(grid)
            options["physics"] = image.physics
            if (mtf := filter_factor(image.physics or {})) is not None:
                options["with_filter"] = filtered(*scan, filters[which], clean, engine, mtf)
        else:
            voxels = voxels_over(grid, image.voxels.spacing_mm)
            _, masks = read_masks(rois_files[image.protocol][lanes[0]], voxels)
            boxes = boxes_around(masks.values(), voxels)
            options["thickness_mm"] = image.voxels.thickness_mm
        made = back_project(projections.of_filters(which), voxels, boxes, **options, **common)
        for image, volumes in zip(alike, made, strict=True):
            yield from ((image.protocol, lane, volume) for lane, volume in zip(lanes, volumes, strict=True))


def _pairs(of_filters, rois_files):
    """Yield filters, as a slice of their numbers, and images that differ in the filter only: two of them, or one."""

    def all_else(image):
        return image.voxels, image.physics, rois_files.get(image.protocol)

    first, *second = of_filters
    left = [image for images in second for image in images]
    for image in first:
        other = next((one for one in left if all_else(one) == all_else(image)), None)
        if other is None:
            yield slice(0, 1), [image]
        else:
            left.remove(other)
            yield slice(0, 2), [image, other]
    yield from ((slice(1, 2), [image]) for image in left)


def _equal(keys: Iterable[Hashable]) -> list[list[int]]:
    """Return lists of the numbers of equal keys, in the order in which the keys occur."""
    together: dict[Hashable, list[int]] = {}
    for number, key in enumerate(keys):
        together.setdefault(key, []).append(number)
    return list(together.values())


def _some(line_integrals: np.ndarray, lanes: list[int]) -> np.ndarray:
    """Return some realizations, without a copy if these are all."""
    return line_integrals if len(lanes) == len(line_integrals) else line_integrals[lanes]


def _volumes(hu, grid, physics, after_filter=None):
    """Return volumes with effects on images; `after_filter` are the images with the filter among them."""
    pairs = [()] * len(hu) if after_filter is None else zip(hu, after_filter, strict=True)
    images = [apply_image_effects(one, grid.spacing, physics or {}, pair) for one, pair in zip(hu, pairs, strict=True)]
    return [Volume(_to_int16(image), grid) for image in images]


def _to_int16(image: np.ndarray) -> np.ndarray:
    """Return HU as int16, with a warning about values out of range. Raises InputError for NaN and infinite voxels."""
    whole, beyond = rounded_hu(
        image, "reconstruction: holds voxels that are NaN or infinite; are the projections finite?"
    )
    if beyond:
        limits = np.iinfo(np.int16)
        warnings.warn(
            f"reconstruction: {beyond} voxels are beyond {limits.min} to {limits.max} HU and are set to these limits",
            stacklevel=4,
        )
    return whole
