"""Average repeated scans of one object to use the mean as a phantom: the noise of a single scan would be scanned again.

Scans are averaged without interpolation, which would blur them. Scans in which the object moved relative to the first
scan are rejected. The result includes the spectra of the mean and of its remaining noise.
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
from .deconvolution import PowerSpectra, measure_spectra
from .displacement import displacement
from .masks import open_regions
from .regions import GRID_TOLERANCE_MM

LARGEST_MM = 0.2  # largest displacement: a third of a voxel, which widens an edge of 1.2 mm by 2 %
LEAST_OVERLAP = 0.8  # Dice coefficient with the majority of scans; regions on other slices or sides are far below
THIN_MM = 6.0  # thinner pieces are not part of the object: shell of a table, sheets, cables
AROUND_MM = 3.0  # margin of air around the object
SPARE_MM = 5.0  # margin above and below the grid


@dataclass(frozen=True)
class ScanFiles:
    """A scan: its name, the folder of the CT, and the file of its regions."""

    name: str
    ct: Path
    regions: Path


@dataclass(frozen=True)
class MeanScan:
    """The mean of scans, with air around the object.

    Attributes
    ----------
    image : Volume
        HU, float32, centered on the regions along z and on the object in-plane.
    labels : ndarray of uint8, shape (z, y, x)
        1, 2, ... in the order of the regions; 0 for background.
    rows : list of dict
        Displacement of each scan relative to the first: scan, x_mm, y_mm, z_mm, turn_deg, largest_mm.
    noise_hu : float
        Noise SD of a single scan in the regions, estimated from the differences between scans.
    spectra : PowerSpectra
        Power of the mean and of its noise, in the bounding box of the regions.
    """

    image: Volume
    labels: np.ndarray
    rows: list[dict]
    noise_hu: float
    spectra: PowerSpectra

    @property
    def remaining_hu(self) -> float:
        """SD of the noise in the mean."""
        return self.noise_hu / math.sqrt(len(self.rows))


def average_scans(scans: Sequence[ScanFiles], regions: Sequence[int | str], height_mm: float) -> MeanScan:
    """Average at least two scans of an object that was not moved. Only one full scan is in memory at a time.

    Parameters
    ----------
    regions : sequence of int or str
        Numbers or names of the regions in the file of each scan.
    height_mm : float
        Extent along z to keep, around the center of the regions.

    Raises
    ------
    InputError
        If a scan cannot be read, its grid differs, its object or a region is displaced, or two regions overlap.
    """
    first, *others = scans
    if not others:
        raise InputError(f"{first.ct}: is the only scan; give at least two acquisitions")
    image = read_hu(first.ct)
    full_grid = image.grid
    masks = _regions(first, regions, full_grid)
    part = _part(image, masks, height_mm, first.ct)
    reference = _cut(image, part)
    drawn = np.any(masks, axis=0)[part]
    body = object_mask(reference, drawn)
    votes = masks[(slice(None), *part)].astype(np.uint16)
    total, values = reference.array.astype(np.float64), [reference.array[drawn]]
    pairs = len(scans) // 2  # differences of pairs contain only noise; with an odd number, the last scan is not used
    differences = reference.array.astype(np.float32)
    rows = [{"scan": first.name, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0, "turn_deg": 0.0, "largest_mm": 0.0}]
    drawn_in = {first.name: masks[(slice(None), *part)]}
    for number, scan in enumerate(others, start=1):
        image = read_hu(scan.ct)
        if not image.grid.matches(full_grid, GRID_TOLERANCE_MM):
            raise InputError(f"{scan.ct}: is on another grid ({image.grid}) than {first.ct} ({full_grid}); exclude it")
        cropped = replace(_cut(image, part), grid=reference.grid)
        rows.append(_row(scan, cropped, reference, body, first))
        total += cropped.array
        if number < 2 * pairs:
            differences += cropped.array if number % 2 == 0 else -cropped.array
        values.append(cropped.array[drawn])
        drawn_in[scan.name] = _regions(scan, regions, full_grid)[(slice(None), *part)]
        votes += drawn_in[scan.name]
    majority = 2 * votes > len(scans)
    _check_regions(drawn_in, majority, regions, scans)
    mean = (total / len(scans)).astype(np.float32)
    mean = np.where(object_mask(Volume(mean, reference.grid), majority.any(axis=0)), mean, np.float32(HU_AIR))
    labels = np.zeros(mean.shape, np.uint8)
    for number, mask in enumerate(majority, start=1):
        labels[mask] = number
    noise = math.sqrt(float(np.var(values, axis=0, ddof=1, dtype=np.float64).mean()))
    differences /= math.sqrt(2 * pairs * len(scans))  # n pairs to the noise of the mean of N scans
    box = find_objects((labels > 0).astype(np.uint8))[0]
    dense = mean[box] > HU_BODY
    filled = np.where(dense, mean[box], mean[box][dense].mean())  # the edge to air would count as texture
    in_box = filled, differences[box]
    return MeanScan(Volume(mean, reference.grid), labels, rows, noise, measure_spectra(*in_box, reference.grid.spacing))


def object_mask(image: Volume, inside: np.ndarray) -> np.ndarray:
    """Return the voxels of an object and a margin of air, without the table.

    Parameters
    ----------
    inside : ndarray of bool, shape (z, y, x)
        Some voxels of the object.

    Raises
    ------
    InputError
        If no part denser than HU_BODY and thicker than THIN_MM contains these voxels.
    """
    dense = np.stack([binary_fill_holes(plane) for plane in image.array > HU_BODY])
    _, dy, dx = image.grid.spacing
    thick = np.zeros_like(dense)
    for plane, out in zip(dense, thick, strict=True):  # morphological opening by a disc in each slice
        core = distance_transform_edt(np.pad(plane, 1), sampling=(dy, dx))[1:-1, 1:-1] > THIN_MM / 2
        if core.any():
            out[:] = distance_transform_edt(~core, sampling=(dy, dx)) <= THIN_MM / 2
    pieces, _ = label(thick)
    votes = np.bincount(pieces[inside], minlength=2)
    votes[0] = 0
    if not votes.any():
        raise InputError(f"scans: the regions lie in no object that is denser than {HU_BODY:g} HU; is the CT in HU?")
    kept = pieces == votes.argmax()
    return binary_dilation(kept, _disc(AROUND_MM, dy, dx)[None])


def _disc(radius_mm: float, dy: float, dx: float) -> np.ndarray:
    y, x = math.ceil(radius_mm / dy), math.ceil(radius_mm / dx)
    rows, columns = np.ogrid[-y : y + 1, -x : x + 1]
    return (rows * dy) ** 2 + (columns * dx) ** 2 <= radius_mm**2


def _regions(scan: ScanFiles, regions: Sequence[int | str], grid: Grid) -> np.ndarray:
    """Read the regions of one scan, bool [region, z, y, x]."""
    opened = open_regions(scan.regions, grid)
    masks = np.stack([opened.mask(region) for region in regions])
    for region, mask in zip(regions, masks, strict=True):
        if not mask.any():
            raise InputError(f"{scan.regions}: region {region} is empty; exclude the scan")
    return masks


def _part(image: Volume, masks: np.ndarray, height_mm: float, source: Path) -> tuple[slice, slice, slice]:
    """Return the slices, rows and columns to keep: height_mm around the regions, and the object in-plane."""
    grid = image.grid
    drawn = np.flatnonzero(masks.any(axis=(0, 2, 3)))
    middle = (drawn[0] + drawn[-1] + 1) / 2
    half = min((height_mm / 2 + SPARE_MM) / grid.spacing[0], middle, grid.shape[0] - middle)
    z = slice(math.ceil(middle - half), math.floor(middle + half))
    body = object_mask(_cut(image, (z, slice(None), slice(None))), masks.any(axis=0)[z])
    edges = [np.flatnonzero(body.any(axis=axes)) for axes in ((0, 2), (0, 1))]
    return z, *(slice(int(edge[0]), int(edge[-1]) + 1) for edge in edges)


def _cut(image: Volume, part: tuple[slice, slice, slice]) -> Volume:
    array = np.ascontiguousarray(image.array[part])
    axes = [axis + centre for axis, centre in zip(image.grid.axes_mm(), image.grid.centre_mm[::-1], strict=True)]
    centre = tuple(float(axis[kept].mean()) for axis, kept in zip(axes, part, strict=True))[::-1]
    return Volume(array, replace(image.grid, shape=array.shape, centre_mm=centre, directions=None))


def _row(scan: ScanFiles, image: Volume, reference: Volume, body: np.ndarray, first: ScanFiles) -> dict:
    """Return the displacement of the object relative to the first scan; InputError if it is too large."""
    moved = displacement(image, reference, body)
    if moved is None:
        raise InputError(f"{first.ct}: shows no edge to which scans can be aligned; is the CT in HU?")
    if moved.largest_mm > LARGEST_MM:
        raise InputError(
            f"{scan.ct}: the object is displaced by up to {moved.largest_mm:.1f} mm relative to {first.ct}, and at "
            f"most {LARGEST_MM:g} mm is allowed; exclude acquisitions with re-positioning"
        )
    x, y, z = moved.shift_mm
    turn = float(np.linalg.norm(moved.turn_deg))
    return {"scan": scan.name, "x_mm": x, "y_mm": y, "z_mm": z, "turn_deg": turn, "largest_mm": moved.largest_mm}


def _check_regions(
    drawn_in: dict[str, np.ndarray], majority: np.ndarray, regions: Sequence[int | str], scans: Sequence[ScanFiles]
) -> None:
    if (majority.sum(axis=0) > 1).any():
        raise InputError(f"{scans[0].regions}: regions overlap; assign each voxel to one region")
    for scan in scans:
        for region, mask, usual in zip(regions, drawn_in[scan.name], majority, strict=True):
            sizes = int(mask.sum()) + int(usual.sum())
            if not sizes or 2 * int((mask & usual).sum()) < LEAST_OVERLAP * sizes:
                raise InputError(
                    f"{scan.regions}: region {region} differs from most of the scans in position; exclude this scan"
                )
