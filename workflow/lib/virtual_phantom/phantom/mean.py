"""The mean of repeated scans of one object as the phantom: one scan's noise would be scanned again.

Scans are averaged as they lie, never interpolated, which would blur them: each is held against the first, and one that
lies elsewhere is refused. What the mean has of the scans' blur and noise is in its description.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, binary_fill_holes, distance_transform_edt, find_objects, label

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_AIR, HU_BODY
from ..io.volumes import Volume
from .ct import read_hu
from .displacement import displacement
from .masks import GRID_TOLERANCE_MM, open_regions
from .own_blur import Spectra, spectra

LARGEST_MM = 0.2  # that an object may lie elsewhere: a third of a voxel, which widens an edge of 1.2 mm by a fiftieth
LEAST_OVERLAP = 0.8  # Dice of a scan's region and that of most: drawn on other slices or sides, it is far below
THIN_MM = 6.0  # across: a table's shell, sheets and cables are thinner, and are no part of the object
AROUND_MM = 3.0  # air that is left around the object
SPARE_MM = 5.0  # of the scan, above and below the grid


@dataclass(frozen=True)
class ScanFiles:
    """Where one scan lies.

    Attributes
    ----------
    ct : Path
        Folder of its CT.
    regions : Path
        File of its regions.
    """

    name: str
    ct: Path
    regions: Path


@dataclass(frozen=True)
class MeanScan:
    """The mean of scans, air around the object.

    Attributes
    ----------
    image : Volume
        HU, float32; its centre is that of the regions along z, and of the object in the plane.
    labels : ndarray of uint8, shape (z, y, x)
        1, 2, ... in the order of the regions asked for; 0: none.
    rows : list of dict
        A row per scan: scan, x_mm, y_mm, z_mm and turn_deg against the first, largest_mm.
    noise_hu : float
        SD of one scan's voxels between scans, in the regions.
    spectra : Spectra
        Power of the mean and of the noise in it, in the box around the regions.
    """

    image: Volume
    labels: np.ndarray
    rows: list[dict]
    noise_hu: float
    spectra: Spectra

    @property
    def remaining_hu(self) -> float:
        """SD of the noise that is left in the mean."""
        return self.noise_hu / math.sqrt(len(self.rows))


def mean_of(scans: Sequence[ScanFiles], regions: Sequence[int | str], height_mm: float) -> MeanScan:
    """Average scans of one object that was not moved.

    Parameters
    ----------
    scans : sequence of ScanFiles
        Two at least; a scan is in memory at a time, beside the part of it that is kept.
    regions : sequence of int or str
        Numbers or names of the regions in each scan's file.
    height_mm : float
        Of the part to keep, along z around the regions' middle.

    Raises
    ------
    InputError
        If a scan cannot be read, lies on another grid, its object elsewhere or its regions elsewhere than in the first,
        or two regions overlap.
    """
    first, *others = scans
    if not others:
        raise InputError(f"{first.ct}: is one scan; a mean needs two at least, so give more acquisitions")
    image = read_hu(first.ct)
    whole = image.grid
    masks = _regions(first, regions, whole)
    part = _part(image, masks, height_mm, first.ct)
    reference = _cut(image, part)
    drawn = np.any(masks, axis=0)[part]
    body = object_of(reference, drawn)
    votes = masks[(slice(None), *part)].astype(np.uint16)
    total, values = reference.array.astype(np.float64), [reference.array[drawn]]
    pairs = len(scans) // 2  # what the scans of a pair differ by is noise alone; an odd one out is in no pair
    differences = reference.array.astype(np.float32)
    rows = [{"scan": first.name, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0, "turn_deg": 0.0, "largest_mm": 0.0}]
    own = {first.name: masks[(slice(None), *part)]}
    for number, scan in enumerate(others, start=1):
        image = read_hu(scan.ct)
        if not image.grid.matches(whole, GRID_TOLERANCE_MM):
            raise InputError(f"{scan.ct}: is on another grid ({image.grid}) than {first.ct} ({whole}); leave it out")
        there = replace(_cut(image, part), grid=reference.grid)
        rows.append(_row(scan, there, reference, body, first))
        total += there.array
        if number < 2 * pairs:
            differences += there.array if number % 2 == 0 else -there.array
        values.append(there.array[drawn])
        own[scan.name] = _regions(scan, regions, whole)[(slice(None), *part)]
        votes += own[scan.name]
    most = 2 * votes > len(scans)
    _check_regions(own, most, regions, scans)
    mean = (total / len(scans)).astype(np.float32)
    mean = np.where(object_of(Volume(mean, reference.grid), most.any(axis=0)), mean, np.float32(HU_AIR))
    labels = np.zeros(mean.shape, np.uint8)
    for number, mask in enumerate(most, start=1):
        labels[mask] = number
    noise = math.sqrt(float(np.var(values, axis=0, ddof=1, dtype=np.float64).mean()))
    differences /= math.sqrt(2 * pairs * len(scans))  # to the noise of the mean: of 2 n scans, of which N are averaged
    box = find_objects((labels > 0).astype(np.uint8))[0]
    dense = mean[box] > HU_BODY
    filled = np.where(dense, mean[box], mean[box][dense].mean())  # a surface against air would pass for texture
    in_box = filled, differences[box]
    return MeanScan(Volume(mean, reference.grid), labels, rows, noise, spectra(*in_box, reference.grid.spacing))


def object_of(image: Volume, inside: np.ndarray) -> np.ndarray:
    """The voxels of an object and a rim of air, without the table that it lies on.

    Parameters
    ----------
    image : Volume
        HU.
    inside : ndarray of bool, shape (z, y, x)
        Some of the object's voxels.

    Returns
    -------
    ndarray of bool, shape (z, y, x)

    Raises
    ------
    InputError
        If they are not in something that is denser than HU_BODY and thicker than THIN_MM.
    """
    dense = np.stack([binary_fill_holes(plane) for plane in image.array > HU_BODY])
    _, dy, dx = image.grid.spacing
    thick = np.zeros_like(dense)
    for plane, out in zip(dense, thick, strict=True):  # opened by a disc, slice by slice
        core = distance_transform_edt(np.pad(plane, 1), sampling=(dy, dx))[1:-1, 1:-1] > THIN_MM / 2
        if core.any():
            out[:] = distance_transform_edt(~core, sampling=(dy, dx)) <= THIN_MM / 2
    pieces, _ = label(thick)
    votes = np.bincount(pieces[inside], minlength=2)
    votes[0] = 0
    if not votes.any():
        raise InputError(f"scans: the regions lie in nothing that is denser than {HU_BODY:g} HU; is the CT in HU?")
    kept = pieces == votes.argmax()
    return binary_dilation(kept, _disc(AROUND_MM, dy, dx)[None])


def _disc(radius_mm: float, dy: float, dx: float) -> np.ndarray:
    y, x = math.ceil(radius_mm / dy), math.ceil(radius_mm / dx)
    rows, columns = np.ogrid[-y : y + 1, -x : x + 1]
    return (rows * dy) ** 2 + (columns * dx) ** 2 <= radius_mm**2


def _regions(scan: ScanFiles, regions: Sequence[int | str], grid: Grid) -> np.ndarray:
    """The regions of one scan, bool [region, z, y, x]."""
    opened = open_regions(scan.regions, grid)
    masks = np.stack([opened.mask(region) for region in regions])
    for region, mask in zip(regions, masks, strict=True):
        if not mask.any():
            raise InputError(f"{scan.regions}: region {region} is empty; leave the scan out")
    return masks


def _part(image: Volume, masks: np.ndarray, height_mm: float, source: Path) -> tuple[slice, slice, slice]:
    """Which slices, rows and columns are kept: around the middle of the regions, and of what is denser than air."""
    grid = image.grid
    drawn = np.flatnonzero(masks.any(axis=(0, 2, 3)))
    middle = (drawn[0] + drawn[-1] + 1) / 2
    half = min((height_mm / 2 + SPARE_MM) / grid.spacing[0], middle, grid.shape[0] - middle)
    z = slice(math.ceil(middle - half), math.floor(middle + half))
    body = object_of(_cut(image, (z, slice(None), slice(None))), masks.any(axis=0)[z])
    edges = [np.flatnonzero(body.any(axis=axes)) for axes in ((0, 2), (0, 1))]
    return z, *(slice(int(edge[0]), int(edge[-1]) + 1) for edge in edges)


def _cut(image: Volume, part: tuple[slice, slice, slice]) -> Volume:
    array = np.ascontiguousarray(image.array[part])
    places = [axis + centre for axis, centre in zip(image.grid.axes_mm(), image.grid.centre_mm[::-1], strict=True)]
    centre = tuple(float(place[kept].mean()) for place, kept in zip(places, part, strict=True))[::-1]
    return Volume(array, replace(image.grid, shape=array.shape, centre_mm=centre, directions=None))


def _row(scan: ScanFiles, image: Volume, reference: Volume, body: np.ndarray, first: ScanFiles) -> dict:
    """How far the object lies from where it lies in the first scan; InputError if that is too far."""
    moved = displacement(image, reference, body)
    if moved is None:
        raise InputError(f"{first.ct}: shows no edge by which scans could be compared; is the CT in HU?")
    if moved.largest_mm > LARGEST_MM:
        raise InputError(
            f"{scan.ct}: the object lies up to {moved.largest_mm:.1f} mm from where it lies in {first.ct}, and at most "
            f"{LARGEST_MM:g} mm is averaged; leave out acquisitions with re-positioning"
        )
    x, y, z = moved.shift_mm
    turn = float(np.linalg.norm(moved.turn_deg))
    return {"scan": scan.name, "x_mm": x, "y_mm": y, "z_mm": z, "turn_deg": turn, "largest_mm": moved.largest_mm}


def _check_regions(
    own: dict[str, np.ndarray], most: np.ndarray, regions: Sequence[int | str], scans: Sequence[ScanFiles]
) -> None:
    if (most.sum(axis=0) > 1).any():
        raise InputError(f"{scans[0].regions}: regions overlap; every voxel can be of one")
    for scan in scans:
        for region, mask, of_most in zip(regions, own[scan.name], most, strict=True):
            sizes = int(mask.sum()) + int(of_most.sum())
            if not sizes or 2 * int((mask & of_most).sum()) < LEAST_OVERLAP * sizes:
                raise InputError(
                    f"{scan.regions}: region {region} lies elsewhere than in most of the scans; leave this one out"
                )
