"""Reconstructed images, with the effects that act on them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from ..base.geometry import Grid, ScanGeometry
from ..base.settings import FbpSettings, SirtSettings
from ..base.units import rounded_hu
from ..io.volumes import Volume
from ..physics.effect import image_effects, load
from ..physics.image_state import ImageState
from ..reconstruction.boxes import Box, back_in_boxes
from ..reconstruction.fbp import ParallelProjections
from ..reconstruction.images import reconstruct_hu


def apply_image_effects(
    hu: np.ndarray, spacing_mm: tuple[float, float, float], physics: Mapping[str, Mapping[str, float]]
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
    """
    if not physics:
        return hu
    state = ImageState(np.asarray(hu, np.float32), spacing_mm)
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
    hu = reconstruct_hu(line_integrals, geometry, grid, algorithm, settings, engine, mu_water_per_mm, threads)
    return _volumes(hu, grid, physics)


def back_project(
    projections: ParallelProjections,
    grid: Grid,
    boxes: Sequence[Box],
    *,
    mu_water_per_mm: float,
    thickness_mm: float | None = None,
    physics: Mapping[str, Mapping[str, float]] | None = None,
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

    Returns
    -------
    list of Volume
        int16 HU on `grid`.
    """
    hu = back_in_boxes(
        projections, grid, boxes, mu_water_per_mm=mu_water_per_mm, thickness_mm=thickness_mm, threads=threads
    )
    return _volumes(hu, grid, physics)


def _volumes(hu, grid, physics):
    return [Volume(_to_int16(apply_image_effects(image, grid.spacing, physics or {})), grid) for image in hu]


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
