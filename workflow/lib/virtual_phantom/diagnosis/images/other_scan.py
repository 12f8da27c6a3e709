"""Another scan of the same object, in place of a description of it.

The mean of some slices is the model, and also an object that is constant along z, as in setting.simulated_images. In
the other slices, both scans are compared, so that the differences between slices show the noise of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.pose import Pose
from ...base.units import HU_AIR
from ...io.volumes import Volume
from ...phantom.ct import read_hu
from ...phantom.regions import GRID_TOLERANCE_MM
from ...recordings.document import FILE_NAME
from ...recordings.images import ImagesRecording
from ...recordings.reading import load_recording
from ..comparison.regions import sampled
from ..request import DiagnosisRequest
from ..scanned_object import shown_slices

CUBIC = 3  # order of splines, which blur less than linear interpolation


def with_other_scan(request: DiagnosisRequest, recording: ImagesRecording) -> DiagnosisRequest:
    """Return the request with the other scan at the slices of the recording; itself if the object is no scan.

    The scan keeps its own pixels. Heights are read from the files.

    Raises
    ------
    InputError
        If the scan cannot be read, or does not show the stated slices or any slice.
    """
    settings = request.settings
    if not settings.of_scan:
        return request
    scan, path = read_scan(settings.object.scan, recording), settings.object.scan
    wanted, there = heights_mm(recording.grid) - settings.location.get("z_mm", 0.0), heights_mm(scan.grid)
    seen = np.flatnonzero((wanted > there[0] - GRID_TOLERANCE_MM) & (wanted < there[-1] + GRID_TOLERANCE_MM))
    ends = f"z = {there[0]:.6g} to {there[-1]:.6g} mm, the recording those at {wanted[0]:.6g} to {wanted[-1]:.6g} mm"
    if not len(seen):
        raise InputError(f"{path}: shows the slices at {ends}; give a scan of the same part of the object")
    stated = settings.slices
    if stated is not None and not seen[0] <= stated[0] <= stated[1] <= seen[-1]:
        raise InputError(f"{path}: shows the slices at {ends}; give slices from {seen[0]} to {seen[-1]} alone")
    shown = seen[shown_slices(None, len(seen))] if stated is None else stated
    place = np.clip((wanted - there[0]) / scan.grid.spacing[0], 0, len(there) - 1)
    below = np.floor(place).astype(int)
    share = (place - below)[:, None, None].astype(np.float32)
    array = (1 - share) * scan.array[below] + share * scan.array[np.minimum(below + 1, len(there) - 1)]
    grid = Grid(array.shape, (recording.grid.spacing[0], *scan.grid.spacing[1:]))
    slices = int(shown[0]), int(shown[-1])
    return replace(request, settings=replace(settings, slices=slices), other_scan=Volume(array, grid))


def read_scan(path: str | Path, recording: ImagesRecording) -> Volume:
    """Read an image in HU, or the mean of the repeats of a recording of images.

    Raises
    ------
    InputError
        If it cannot be read, holds no images, or is the diagnosed recording.
    """
    if not (Path(path) / FILE_NAME).is_file():
        return read_hu(Path(path))
    other = load_recording(path)
    if other.kind != "images":
        raise InputError(f"{other.document.path}: holds {other.kind}; give a recording of images")
    if other.document.path.resolve() == recording.document.path.resolve():
        raise InputError(f"{path}: is the diagnosed recording; give another scan of the object")
    count = len(other.repeats) + len(other.held_out)
    return Volume(sum(image.array / count for image in chain(other.repeats, other.held_out)), other.grid)


def heights_mm(grid: Grid) -> np.ndarray:
    """Return z of the slices of a grid in the frame of its file, mm."""
    return grid.centre_mm[2] + grid.axes_mm()[0]


def alternate_slices(count: int, step: int) -> tuple[slice, slice]:
    """Return alternate slices: the slices of the model, and the compared slices.

    A model with the noise of the compared slices would fit better if an effect smoothed it. Slices at the distance
    `step` have independent noise. Both have the same mean height.
    """
    end = count - (count - 1) % (2 * step)
    return slice(step, end, 2 * step), slice(0, end, 2 * step)


def placed(
    scan: Volume, grid: Grid, slices: tuple[int, int], location: Mapping[str, float], order: int = CUBIC
) -> Volume:
    """Return a scan of the object at this location, interpolated on the pixels of a grid; air in other slices."""
    pose = Pose(**{key: value for key, value in location.items() if key != "z_mm"})
    of, at = (Grid((1, *one.shape[1:]), one.spacing) for one in (scan.grid, grid))
    array = np.full(grid.shape, HU_AIR, np.float32)
    for z in range(slices[0], slices[1] + 1):
        array[z] = sampled(scan.array[z : z + 1], of, at, pose, order, outside=HU_AIR)
    return Volume(array, grid)
