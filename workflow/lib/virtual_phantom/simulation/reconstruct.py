"""Reconstructed images, with the effects that act on them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
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
) -> list[Volume]:
    """Return one image per acquisition from filtered projections, with air outside of the boxes.

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
    list of Volume
        int16 HU on `grid`.
    """
    how = {"mu_water_per_mm": mu_water_per_mm, "thickness_mm": thickness_mm, "threads": threads}
    hu, after = (None if one is None else back_in_boxes(one, grid, boxes, **how) for one in (projections, with_filter))
    return _volumes(hu, grid, physics, after)


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
    """Reconstruct all realizations of all protocols that share scans, and filter once for each kernel.

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
    for settings in dict.fromkeys(image.settings for image in images):
        alike = [image for image in images if image.settings == settings]
        filters_first = filters_projections(alike[0].algorithm, settings)
        # Lanes of one reconstruction share the start angle; for FBP, also the position and the noise-free scan. On a
        # GPU, filtered projections of one lane at a time save memory.
        if not filters_first:
            keys = [float(scan.angles_rad[0]) for scan in scans.geometries]
        else:
            keys = scans.sources if engine == "cpu" else range(len(scans.sources))
        for key in dict.fromkeys(keys):
            lanes = [lane for lane, other in enumerate(keys) if other == key]
            every = len(lanes) == len(keys)
            line_integrals = scans.line_integrals if every else scans.line_integrals[lanes]
            geometry, source = scans.geometries[lanes[0]], scans.sources[lanes[0]]
            if filters_first:
                scan = line_integrals, geometry, settings, scans.noise_free.get(source), engine
                projections = filtered(*scan)
            for image in alike:
                if not filters_first:
                    volumes = reconstruct(
                        line_integrals,
                        geometry,
                        grid,
                        image.algorithm,
                        settings,
                        engine=engine,
                        physics=image.physics,
                        **common,
                    )
                elif image.voxels is None:
                    mtf = filter_factor(image.physics or {})
                    own = {"physics": image.physics, "with_filter": None if mtf is None else filtered(*scan, mtf)}
                    volumes = back_project(projections, grid, whole(grid), **own, **common)
                else:
                    voxels = voxels_over(grid, image.voxels.spacing_mm)
                    _, masks = read_masks(rois_files[image.protocol][lanes[0]], voxels)
                    boxes = boxes_around(masks.values(), voxels)
                    volumes = back_project(projections, voxels, boxes, thickness_mm=image.voxels.thickness_mm, **common)
                for lane, volume in zip(lanes, volumes, strict=True):
                    yield image.protocol, lane, volume
            projections = None  # frees memory before the next filter


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
