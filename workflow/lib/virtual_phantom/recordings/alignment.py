"""Alignment of the phantom with a recording of images, and transfer of the phantom's ROIs to the recording's grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.simpleitk import itk_image, itk_resample, matrix_of
from ..io.volumes import Volume
from ..phantom import HALF_COVERED, Roi, block_mean
from .images import ImagesRecording
from .levels import WHOLE_ROI, valid_voxels
from .registration import Alignment, Search, angles_deg, refine


@dataclass(frozen=True)
class RepeatShift:
    """Displacement of a repeat from the first one. Fields are keys of alignment.json.

    Attributes
    ----------
    repeat : str
        File.
    shift_mm : tuple of 3 float
        Displacement of the body's center, (x, y, z).
    rotation_deg : tuple of 3 float
        As in Alignment.
    farthest_mm : float
        Largest displacement of a corner of the body's bounding box.
    """

    repeat: str
    shift_mm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]
    farthest_mm: float


def align_recording(recording: ImagesRecording, phantom: Volume) -> tuple[Alignment, Volume, tuple[RepeatShift, ...]]:
    """Align a recording's mean image with the phantom.

    Each repeat is first aligned separately, at the same resolution, so that errors of the phantom's model cancel in the
    shifts.

    Returns
    -------
    mean : Volume
        HU, float32, on the recording's grid.
    shifts : tuple of RepeatShift
        One per repeat; empty for a single repeat.

    Raises
    ------
    InputError
        If the phantom does not fit (registration.Search), or a repeat moved by more than a voxel from the first one.
    """
    total, first, start, shifts = None, None, None, []
    for path, image in zip(recording.repeats.paths, recording.repeats, strict=True):
        search = Search(image, phantom, recording.name)
        if total is None:
            total = image.array.astype(np.float64)
            start = search.coarse_alignment(recording.isocentre_mm)
            if len(recording.repeats) == 1:
                return search.checked(search.refine_to_finest(start)), image, ()
        else:
            total += image.array
        transform = refine(search.middle, start)
        first = transform if first is None else first
        shift = repeat_shift(recording.document.relative(path), first, transform, search)
        if shift.farthest_mm > (voxel := max(recording.grid.spacing)):
            raise InputError(
                f"{path}: is displaced by up to {shift.farthest_mm:.1f} mm from the first repeat, more than a voxel "
                f"({voxel:g} mm); make a separate recording of it"
            )
        shifts.append(shift)
    mean = Volume((total / len(recording.repeats)).astype(np.float32), recording.grid)
    search = Search(mean, phantom, recording.name)
    return search.checked(search.refine_to_finest(start)), mean, tuple(shifts)


def repeat_shift(
    name: str, first: sitk.Euler3DTransform, transform: sitk.Euler3DTransform, search: Search
) -> RepeatShift:
    """Return the displacement of a repeat from the first one, given both transforms."""
    moved = matrix_of(transform) - matrix_of(first)
    occupied = np.argwhere(search.body)
    corners = np.array(list(product(*zip(occupied.min(axis=0), occupied.max(axis=0), strict=True))))[:, ::-1]
    grid = search.phantom.grid
    corners = corners * grid.spacing[::-1] + grid.affine[:3, 3]
    points = np.column_stack([np.vstack([search.center, corners]), np.ones(len(corners) + 1)]) @ moved[:3].T
    rotation = [after - before for before, after in zip(angles_deg(first), angles_deg(transform), strict=True)]
    return RepeatShift(
        name, tuple(points[0].tolist()), tuple(rotation), float(np.linalg.norm(points[1:], axis=1).max())
    )


def check_same_phantom(recording: ImagesRecording, source: str, image: str | Path | None) -> None:
    """Check that recording.yaml names the study's phantom or none.

    Parameters
    ----------
    source : {"synthetic", "ct", "object"}
        Source of the study's phantom.
    image : str, Path or None
        CT of a phantom with source "ct".

    Raises
    ------
    InputError
        If it names another phantom.
    """
    named = recording.phantom
    if named is None or named == source:
        return
    if image is not None and source == "ct":
        ct = Path(image).resolve()
        if ct in (Path(named).resolve(), (recording.document.folder / named).resolve()):
            return
    study = source if image is None or source != "ct" else f"ct or {image}"
    raise InputError(
        f"{recording.document.path}: phantom is '{named}', but the study's phantom is {study}; correct the key, or use "
        "the configuration of that phantom"
    )


def covered_share(alignment: Alignment, mask: np.ndarray, grid: Grid, image: Volume) -> float:
    """Return the share of a mask (z, y, x; on the phantom's grid) whose voxel centers the recording's image covers."""
    points = np.argwhere(mask)[:, ::-1] * grid.spacing[::-1] + grid.affine[:3, 3]
    target = image.grid
    index = np.rint((alignment.to_recording(points) - target.affine[:3, 3]) / target.spacing[::-1]).astype(int)[:, ::-1]
    within = ((index >= 0) & (index < target.shape)).all(axis=1)
    return float(valid_voxels(image)[tuple(index[within].T)].sum() / max(1, len(index)))


def transfer_rois(
    alignment: Alignment, rois: Sequence[Roi], phantom_grid: Grid, image: Volume, name: str
) -> tuple[Roi, ...]:
    """Transfer the phantom's ROIs to the recording's grid.

    The mask (0 or 1) is interpolated linearly on points no farther apart than the phantom's voxels. It is then averaged
    over each voxel of the recording, and thresholded at one half, as when ROIs are resampled to the study's grid.

    Parameters
    ----------
    rois : sequence of Roi
        Masks on `phantom_grid`.
    image : Volume
        The recording's image, HU.

    Raises
    ------
    InputError
        For an ROI of which the recording covers less than WHOLE_ROI, or that fills no voxel by half.
    """
    to_phantom = alignment.transform.GetInverse()
    samples = max(
        math.ceil(coarse / fine - 1e-6) for coarse, fine in zip(image.grid.spacing, phantom_grid.spacing, strict=True)
    )
    transferred = []
    for roi in rois:
        share = covered_share(alignment, roi.mask, phantom_grid, image)
        if share < WHOLE_ROI:
            raise InputError(
                f"recording {name}: covers only {100 * share:.0f} % of ROI {roi.name}; use a scan of the whole ROI, or "
                "list ROIs under rois in recording.yaml"
            )
        window, box = bounding_box(alignment, roi.mask, phantom_grid, image.grid)
        fine = box.refined(samples)
        share = itk_resample(itk_image(roi.mask.astype(np.float32), phantom_grid), fine, to_phantom, 0.0)
        mask = np.zeros(image.grid.shape, bool)
        mask[window] = block_mean(share, samples) >= HALF_COVERED
        if not mask.any():
            raise InputError(
                f"recording {name}: ROI {roi.name} does not fill half of any voxel ({image.grid}); it is too small, "
                "remove it"
            )
        transferred.append(replace(roi, mask=mask))
    return tuple(transferred)


def bounding_box(
    alignment: Alignment, mask: np.ndarray, grid: Grid, target: Grid
) -> tuple[tuple[slice, slice, slice], Grid]:
    """Return the box of the recording's voxels (on grid `target`) that contains a transferred mask: slices and grid."""
    occupied = np.argwhere(mask)[:, ::-1]
    ends = zip(occupied.min(axis=0) - 1, occupied.max(axis=0) + 1, strict=True)
    corners = np.array(list(product(*ends))) * grid.spacing[::-1] + grid.affine[:3, 3]
    index = ((alignment.to_recording(corners) - target.affine[:3, 3]) / target.spacing[::-1])[:, ::-1]
    low = np.clip(np.floor(index.min(axis=0)).astype(int), 0, np.array(target.shape) - 1)
    high = np.clip(np.ceil(index.max(axis=0)).astype(int) + 1, low + 1, target.shape)
    middle = target.affine[:3, :3] @ ((low + high - 1) / 2)[::-1] + target.affine[:3, 3]
    window = tuple(slice(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
    return window, Grid(tuple(high - low), target.spacing, tuple(middle))
