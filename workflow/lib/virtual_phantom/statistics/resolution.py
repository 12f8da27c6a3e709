"""Resolution from edges: the edge spread function, and where its modulation transfer function (MTF) falls to one half.

Task-based MTF of AAPM Report 233 [1]_, after [2]_: voxels are sorted by their distance to a known boundary, which
samples the edge far more finely than voxels do. A signed distance serves boundaries of any shape.

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
from .image_quality import Measure, noise_of, propagated, slice_correlations

HALF_WIDTH_VOXELS, FLAT_VOXELS = 6.0, 4.0  # of the window around the edge, and of its part that counts fully
BINS_PER_VOXEL = 4  # of the oversampled edge (ISO 12233)
SECTORS = 8  # of directions: pieces of the edge with noises of their own
LEAST_FILLED = 0.5  # share of bins
FREQUENCIES, MOST_PER_VOXEL = 400, 2.0  # of the MTF, and cycles per voxel up to which it is taken


def signed_distance_mm(mask: np.ndarray, spacing: Sequence[float], factor: int = 1) -> np.ndarray:
    """Distance of every voxel's centre from a region's boundary in its own slice, negative within.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, factor * y, factor * x)
        Where the region is, sampled finer in the plane than the result; the boundary lies half-way between its samples,
        so that a factor of 1 places it to half a voxel.
    spacing : sequence of 3 float
        mm (z, y, x) of the result.
    factor : int, optional
        Odd.

    Returns
    -------
    ndarray, shape (z, y, x)
        mm. A slice without a boundary is infinitely far off, with the sign.
    """
    first, fine = factor // 2, [step / factor for step in spacing[1:]]
    result = np.empty((len(mask), mask.shape[1] // factor, mask.shape[2] // factor))
    for plane, distance in zip(mask, result, strict=True):
        if plane.all() or not plane.any():
            distance[...] = -np.inf if plane.all() else np.inf
            continue
        out, inside = (ndimage.distance_transform_edt(one, fine) for one in (~plane, plane))
        half = min(fine) / 2
        distance[...] = np.where(plane, half - inside, out - half)[first::factor, first::factor]
    return result


def mtf_half(images: np.ndarray, distance_mm: np.ndarray, spacing: Sequence[float], valid: np.ndarray) -> Measure:
    """Frequency at which the MTF is one half, 1/mm (f50).

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    distance_mm : ndarray, shape (z, y, x)
        Signed distance from the edge in the axial plane, mm.
    spacing : sequence of 3 float
        mm (z, y, x).
    valid : ndarray of bool, shape (z, y, x)
        Voxels that may be used.

    Raises
    ------
    InputError
        If too few voxels lie at the edge, or the MTF does not fall to one half.
    """
    pixel = max(spacing[1:])
    step = pixel / BINS_PER_VOXEL
    half = HALF_WIDTH_VOXELS * pixel
    bins = int(round(2 * half / step))
    near = valid & (np.abs(distance_mm) < half)
    index = np.floor((distance_mm[near] + half) / step).astype(int).clip(0, bins - 1)
    count = np.bincount(index, minlength=bins)
    filled = count > 0
    if filled.mean() < LEAST_FILLED:
        raise InputError("resolution: too few voxels lie at the edge of the object; is it in the image?")
    place = np.bincount(index, distance_mm[near], bins)[filled] / count[filled]
    edge_mtf = EdgeMtf(place, step, half, FLAT_VOXELS * pixel)

    def sums(values):
        return np.bincount(index, values, bins)[filled] / count[filled]

    edge = sums(images.mean(axis=0, dtype=np.float64)[near])
    value = edge_mtf.half(edge)
    if len(images) < 2:
        return Measure(value, np.nan)
    noise = noise_of(images)
    group = _groups(near, spacing)
    parts = np.stack([np.stack([sums(one[near] * (group == number)) for number in np.unique(group)]) for one in noise])
    factor = slice_correlations(noise, near)[0]
    return Measure(value, propagated(edge_mtf.half, edge, parts, len(images)) * float(np.sqrt(factor)))


class EdgeMtf:
    """The MTF of edge spread functions that are sampled at given distances.

    Parameters
    ----------
    place : ndarray, shape (bins,)
        mm from the edge.
    step, half : float
        Of the even grid that they are brought to, and how far it goes to either side, mm.
    flat : float
        How far the line spread function counts fully; from there a cosine takes it to 0, mm.
    """

    def __init__(self, place: np.ndarray, step: float, half: float, flat: float):
        self.place = place
        count = int(round(2 * half / step))
        self.grid = (np.arange(count) + 0.5) * step - half
        middle = (self.grid[1:] + self.grid[:-1]) / 2
        beyond = np.clip((np.abs(middle) - flat) / (half - flat), 0, 1)
        self.window = 0.5 + 0.5 * np.cos(np.pi * beyond)
        self.frequency = np.linspace(0, MOST_PER_VOXEL / (step * BINS_PER_VOXEL), FREQUENCIES)
        self.kernel = np.exp(-2j * np.pi * np.outer(self.frequency, middle))
        # Averages over bins and differences of neighbouring ones blur: both by the same sinc.
        self.blur = np.sinc(self.frequency * step) ** 2

    def of(self, edge: np.ndarray) -> np.ndarray:
        """MTF of an edge spread function at `frequency`, 1 at frequency 0."""
        line = np.diff(np.interp(self.grid, self.place, edge)) * self.window
        transfer = np.abs(self.kernel @ line)
        return transfer / transfer[0] / self.blur

    def half(self, edge: np.ndarray) -> float:
        """Where the MTF first falls to one half, 1/mm.

        Parameters
        ----------
        edge : ndarray, shape (bins,)
            Edge spread function.

        Raises
        ------
        InputError
            If it does not.
        """
        transfer = self.of(edge)
        below = np.flatnonzero(transfer < 0.5)
        if not below.size:
            raise InputError("resolution: no edge spreads over voxels here; is the object in the image?")
        last = below[0]
        share = (transfer[last - 1] - 0.5) / (transfer[last - 1] - transfer[last])
        return float(self.frequency[last - 1] + share * (self.frequency[last] - self.frequency[last - 1]))


def _groups(near: np.ndarray, spacing: Sequence[float]) -> np.ndarray:
    """Number of the piece of the edge, by slice and direction, of every voxel near it."""
    z, y, x = np.nonzero(near)
    angle = np.arctan2((y - y.mean()) * spacing[1], (x - x.mean()) * spacing[2])
    return z * SECTORS + np.floor((angle / (2 * np.pi) + 0.5) * SECTORS).astype(int).clip(0, SECTORS - 1)
