"""Resolution from edges: the edge spread function and the frequency at which its MTF is one half.

Task-based modulation transfer function (MTF) of AAPM Report 233 [1]_, after [2]_. Voxels are sorted by their signed
distance to a known boundary of any shape, which samples the edge more finely than the voxel size.

References
----------
.. [1] AAPM Report 233, Performance Evaluation of Computed Tomography Systems, 2019.
.. [2] S. Richard et al., Med. Phys. 39, 4115, 2012.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from ..base.errors import InputError
from .image_quality import Measure, noise_contrasts, propagated_error, slice_correlations

HALF_WIDTH_VOXELS, FLAT_VOXELS = 6.0, 4.0  # half-widths of the window around the edge and of its flat part
BINS_PER_VOXEL = 4  # bins of the oversampled edge (ISO 12233)
SECTORS = 8  # angular sectors of the edge, whose noise is independent
LEAST_FILLED = 0.5  # share of bins that must have voxels
FREQUENCIES, MOST_PER_VOXEL = 400, 2.0  # number of frequencies of the MTF, and the largest in cycles per voxel


def signed_distance_mm(mask: np.ndarray, spacing: Sequence[float], factor: int = 1) -> np.ndarray:
    """In-plane distance (mm) of every voxel center from a region's boundary, negative inside the region.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, factor * y, factor * x)
        The region, sampled more finely in the plane than the result. The boundary lies halfway between samples.
    spacing : sequence of 3 float
        mm (z, y, x) of the result.
    factor : int, optional
        In-plane samples per voxel side; odd.

    Returns
    -------
    ndarray, shape (z, y, x)
        Infinite, with the sign, in slices without a boundary.
    """
    first, fine = factor // 2, [step / factor for step in spacing[1:]]
    result = np.empty((len(mask), mask.shape[1] // factor, mask.shape[2] // factor))
    for plane, distance in zip(mask, result, strict=True):
        if plane.all() or not plane.any():
            distance[...] = -np.inf if plane.all() else np.inf
            continue
        outside, inside = (ndimage.distance_transform_edt(region, fine) for region in (~plane, plane))
        half = min(fine) / 2
        distance[...] = np.where(plane, half - inside, outside - half)[first::factor, first::factor]
    return result


def mtf_half(images: np.ndarray, distance_mm: np.ndarray, spacing: Sequence[float], valid: np.ndarray) -> Measure:
    """Frequency (1/mm) at which the MTF is one half (f50).

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    distance_mm : ndarray, shape (z, y, x)
        Signed distance from the edge in the axial plane, mm.
    spacing : sequence of 3 float
        mm (z, y, x).

    Raises
    ------
    InputError
        If too few voxels lie near the edge, or the MTF does not fall to one half.
    """
    pixel = max(spacing[1:])
    half = HALF_WIDTH_VOXELS * pixel
    bins = EdgeBins(distance_mm, valid, pixel, half)
    near = bins.near
    edge_mtf = EdgeMtf(bins.means(distance_mm[near]), bins.step, half, FLAT_VOXELS * pixel)
    edge = bins.means(images.mean(axis=0, dtype=np.float64)[near])
    value = edge_mtf.half(edge)
    if len(images) < 2:
        return Measure(value, np.nan)
    noise = noise_contrasts(images)
    sector = _sectors(near, spacing)
    sectors = np.unique(sector)
    parts = np.stack(
        [np.stack([bins.means(contrast[near] * (sector == number)) for number in sectors]) for contrast in noise]
    )
    factor = slice_correlations(noise, near)[0]
    return Measure(value, propagated_error(edge_mtf.half, edge, parts, len(images)) * float(np.sqrt(factor)))


class EdgeBins:
    """Voxels near an edge, in bins of their distance from it.

    Parameters
    ----------
    distance_mm : ndarray
        Signed distance from the edge, mm.
    valid : ndarray of bool, shape of distance_mm
    pixel : float
        Pixel size, mm.
    half : float
        Half-width of the window around the edge, mm.

    Raises
    ------
    InputError
        If too few voxels lie near the edge.
    """

    def __init__(self, distance_mm: np.ndarray, valid: np.ndarray, pixel: float, half: float):
        self.step = pixel / BINS_PER_VOXEL
        bins = int(round(2 * half / self.step))
        self.near = valid & (np.abs(distance_mm) < half)
        self.index = np.floor((distance_mm[self.near] + half) / self.step).astype(int).clip(0, bins - 1)
        self.count = np.bincount(self.index, minlength=bins)
        self.filled = self.count > 0
        if self.filled.mean() < LEAST_FILLED:
            raise InputError(
                "resolution: too few voxels lie near the edge of the object; check that the object is in the image"
            )

    def means(self, values: np.ndarray) -> np.ndarray:
        """Return the means of values of the voxels `near`, in bins that are not empty."""
        return np.bincount(self.index, values, len(self.count))[self.filled] / self.count[self.filled]


class EdgeMtf:
    """MTF of edge spread functions that are sampled at given distances from the edge.

    Parameters
    ----------
    distance : ndarray, shape (bins,)
        mm from the edge.
    step, half : float
        Step and half-width of the regular grid that the edge is interpolated on, mm.
    flat : float
        Half-width of the flat part of the window on the line spread function, mm. A cosine falls to 0 outside.
    """

    def __init__(self, distance: np.ndarray, step: float, half: float, flat: float):
        self.distance = distance
        count = int(round(2 * half / step))
        self.grid = (np.arange(count) + 0.5) * step - half
        middle = (self.grid[1:] + self.grid[:-1]) / 2
        beyond = np.clip((np.abs(middle) - flat) / (half - flat), 0, 1)
        self.window = 0.5 + 0.5 * np.cos(np.pi * beyond)
        self.frequency = np.linspace(0, MOST_PER_VOXEL / (step * BINS_PER_VOXEL), FREQUENCIES)
        self.kernel = np.exp(-2j * np.pi * np.outer(self.frequency, middle))
        # Averaging over bins and differences of adjacent bins both blur with the same sinc.
        self.blur = np.sinc(self.frequency * step) ** 2

    def mtf(self, edge: np.ndarray) -> np.ndarray:
        """MTF of an edge spread function at `frequency`, 1 at frequency 0."""
        line = np.diff(np.interp(self.grid, self.distance, edge)) * self.window
        transfer = np.abs(self.kernel @ line)
        return transfer / transfer[0] / self.blur

    def half(self, edge: np.ndarray, level: float = 0.5) -> float:
        """Lowest frequency (1/mm) at which the MTF of an edge spread function is one half, or another level.

        Raises
        ------
        InputError
            If the MTF does not fall to the level.
        """
        return first_below(self.frequency, self.mtf(edge), level)


def first_below(frequency: np.ndarray, transfer: np.ndarray, level: float) -> float:
    """Lowest frequency at which a transfer function has fallen to a level; InputError if it does not."""
    below = np.flatnonzero(transfer < level)
    if not below.size:
        raise InputError(
            f"resolution: the MTF does not fall to {level:g}; check that the edge of the object is in the image"
        )
    last = below[0]
    share = (transfer[last - 1] - level) / (transfer[last - 1] - transfer[last])
    return float(frequency[last - 1] + share * (frequency[last] - frequency[last - 1]))


def _sectors(near: np.ndarray, spacing: Sequence[float]) -> np.ndarray:
    """Sector of the edge, numbered by slice and direction, of every voxel near it."""
    z, y, x = np.nonzero(near)
    angle = np.arctan2((y - y.mean()) * spacing[1], (x - x.mean()) * spacing[2])
    return z * SECTORS + np.floor((angle / (2 * np.pi) + 0.5) * SECTORS).astype(int).clip(0, SECTORS - 1)
