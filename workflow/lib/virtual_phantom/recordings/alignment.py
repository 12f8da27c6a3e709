"""Where the phantom lies in a recording of images, and the phantom's ROIs on the recording's own grid.

The transform maps phantom world mm to recording world mm, so that masks go to the image and the image is never
resampled.
"""

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
from .levels import WHOLE_ROI, seen_of
from .registration import Alignment, Search, angles_deg, refine


@dataclass(frozen=True)
class RepeatShift:
    """Where a repeat lies against the first one.

    Attributes
    ----------
    repeat : str
        Its file.
    shift_mm : tuple of 3 float
        Of the body's centre, mm (x, y, z).
    rotation_deg : tuple of 3 float
        As in Alignment, degrees.
    farthest_mm : float
        The farthest that any corner of the body's box moved, mm.
    """

    repeat: str
    shift_mm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]
    farthest_mm: float


def align_recording(recording: ImagesRecording, phantom: Volume) -> tuple[Alignment, Volume, tuple[RepeatShift, ...]]:
    """Align a recording's mean image.

    Each repeat is aligned by itself first, all at the same resolution, so that what the phantom's model lacks drops out
    of the shifts.

    Parameters
    ----------
    phantom : Volume
        HU.

    Returns
    -------
    mean : Volume
        HU, float32, on the recording's grid.
    shifts : tuple of RepeatShift
        Of every repeat; none of a single one.

    Raises
    ------
    InputError
        As `registration.Search` and its result do, and for a repeat that moved by more than a voxel against the first.
    """
    total, first, start, shifts = None, None, None, []
    for path, image in zip(recording.repeats.paths, recording.repeats, strict=True):
        search = Search(image, phantom, recording.name)
        if total is None:
            total = image.array.astype(np.float64)
            start = search.place(recording.isocentre_mm)
            if len(recording.repeats) == 1:
                return search.result(search.finish(start)), image, ()
        else:
            total += image.array
        own = refine(search.middle, start)
        first = own if first is None else first
        shift = shift_of(recording.document.relative(path), first, own, search)
        if shift.farthest_mm > (voxel := max(recording.grid.spacing)):
            raise InputError(
                f"{path}: lies up to {shift.farthest_mm:.1f} mm from the first repeat, more than a voxel ({voxel:g} "
                "mm); make it a recording of its own"
            )
        shifts.append(shift)
    mean = Volume((total / len(recording.repeats)).astype(np.float32), recording.grid)
    search = Search(mean, phantom, recording.name)
    return search.result(search.finish(start)), mean, tuple(shifts)


def shift_of(name: str, first: sitk.Euler3DTransform, own: sitk.Euler3DTransform, search: Search) -> RepeatShift:
    """How far a repeat lies from the first one.

    Parameters
    ----------
    name : str
        Of the repeat.
    first, own : SimpleITK.Euler3DTransform
        Of the first repeat and of this one, phantom world to recording world.
    search : Search
        What holds the phantom's body.
    """
    moved = matrix_of(own) - matrix_of(first)
    occupied = np.argwhere(search.body)
    corners = np.array(list(product(*zip(occupied.min(axis=0), occupied.max(axis=0), strict=True))))[:, ::-1]
    grid = search.phantom.grid
    corners = corners * grid.spacing[::-1] + grid.affine[:3, 3]
    places = np.column_stack([np.vstack([search.centre, corners]), np.ones(len(corners) + 1)]) @ moved[:3].T
    turned = [b - a for a, b in zip(angles_deg(first), angles_deg(own), strict=True)]
    return RepeatShift(name, tuple(places[0].tolist()), tuple(turned), float(np.linalg.norm(places[1:], axis=1).max()))


def check_same_phantom(recording: ImagesRecording, source: str, image: str | Path | None) -> None:
    """Check that a recording is of the study's phantom, or names none.

    Parameters
    ----------
    source : {"synthetic", "ct", "object"}
        Of the study's phantom.
    image : str, Path or None
        The CT of a phantom of source "ct".

    Raises
    ------
    InputError
        If the recording names neither the phantom's source nor the file of its CT.
    """
    named = recording.phantom
    if named is None or named == source:
        return
    if image is not None and source == "ct":
        own = Path(image).resolve()
        if own in (Path(named).resolve(), (recording.document.folder / named).resolve()):
            return
    study = source if image is None or source != "ct" else f"ct or {image}"
    raise InputError(
        f"{recording.document.path}: its phantom is '{named}', the study's is {study}; correct the key, or use the "
        "configuration of that phantom"
    )


def covered_share(alignment: Alignment, mask: np.ndarray, grid: Grid, image: Volume) -> float:
    """Share of a mask whose voxel centres lie in a voxel that the recording really holds.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
    grid : Grid
        Of the mask: the phantom's.
    image : Volume
        The recording's image, HU.
    """
    places = np.argwhere(mask)[:, ::-1] * grid.spacing[::-1] + grid.affine[:3, 3]
    own = image.grid
    index = np.rint((alignment.to_recording(places) - own.affine[:3, 3]) / own.spacing[::-1]).astype(int)[:, ::-1]
    within = ((index >= 0) & (index < own.shape)).all(axis=1)
    return float(seen_of(image)[tuple(index[within].T)].sum() / max(1, len(index)))


def carried_rois(
    alignment: Alignment, rois: Sequence[Roi], phantom_grid: Grid, image: Volume, name: str
) -> tuple[Roi, ...]:
    """The phantom's ROIs on the recording's own grid, which is left as it is.

    The mask (0 or 1) is interpolated linearly at points no farther apart than the phantom's voxels, averaged over each
    voxel of the recording, and cut at one half: as ROIs come onto the study's grid.

    Parameters
    ----------
    rois : sequence of Roi
        Masks on `phantom_grid`.
    image : Volume
        The recording's image, HU.
    name : str
        Of the recording, for messages.

    Raises
    ------
    InputError
        For an ROI of which the recording covers less than WHOLE_ROI, or that fills no voxel by half.
    """
    back = alignment.transform.GetInverse()
    samples = max(
        math.ceil(wide / own - 1e-6) for wide, own in zip(image.grid.spacing, phantom_grid.spacing, strict=True)
    )
    carried = []
    for roi in rois:
        share = covered_share(alignment, roi.mask, phantom_grid, image)
        if share < WHOLE_ROI:
            raise InputError(
                f"recording {name}: covers only {100 * share:.0f} % of ROI {roi.name}; scan all of it, or give the "
                "recording ROIs of its own"
            )
        window, part = window_of(alignment, roi.mask, phantom_grid, image.grid)
        fine = part.refined(samples)
        found = itk_resample(itk_image(roi.mask.astype(np.float32), phantom_grid), fine, back, 0.0)
        mask = np.zeros(image.grid.shape, bool)
        mask[window] = block_mean(found, samples) >= HALF_COVERED
        if not mask.any():
            raise InputError(
                f"recording {name}: ROI {roi.name} fills none of its voxels by half ({image.grid}); it is too small "
                "for them, take it out"
            )
        carried.append(replace(roi, mask=mask))
    return tuple(carried)


def window_of(alignment: Alignment, mask: np.ndarray, grid: Grid, own: Grid) -> tuple[tuple[slice, ...], Grid]:
    """The box of the recording's voxels that holds a carried mask.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
    grid, own : Grid
        Of the mask, and of the recording.

    Returns
    -------
    window : tuple of 3 slice
        Of the recording's voxels (z, y, x).
    part : Grid
        Of the same box.
    """
    occupied = np.argwhere(mask)[:, ::-1]
    ends = zip(occupied.min(axis=0) - 1, occupied.max(axis=0) + 1, strict=True)
    corners = np.array(list(product(*ends))) * grid.spacing[::-1] + grid.affine[:3, 3]
    index = ((alignment.to_recording(corners) - own.affine[:3, 3]) / own.spacing[::-1])[:, ::-1]
    low = np.clip(np.floor(index.min(axis=0)).astype(int), 0, np.array(own.shape) - 1)
    high = np.clip(np.ceil(index.max(axis=0)).astype(int) + 1, low + 1, own.shape)
    middle = own.affine[:3, :3] @ ((low + high - 1) / 2)[::-1] + own.affine[:3, 3]
    window = tuple(slice(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
    return window, Grid(tuple(high - low), own.spacing, tuple(middle))
