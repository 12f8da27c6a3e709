"""Surfaces of labels: the share of each voxel that a material fills, from voxels that are full or empty.

Voxels show a surface as terraces. A smoothing of the voxels leaves waves, which any blur of the scan smooths further.
Sections of the surface are therefore closed curves of as few Fourier coefficients [1]_ as agree with all voxels.

References
----------
.. [1] F. P. Kuhl and C. R. Giardina, Comput. Graph. Image Process. 18, 236, 1982.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

# SD of the Gaussian that smooths terraces where no curve fits, voxels; its reach, in SDs; and the least change per
# voxel next to a surface. Chords of discs with radii of 10 to 200 voxels then have an SD of 0.22 to 0.25 voxels, with
# curves of 0.05 to 0.09. Where a surface is parallel to the grid, errors of its position reach 0.43 and 0.11 voxels.
SIGMA, REACH, LEAST_SLOPE = 1.25, 3.0, 0.02
SHARPENED = 1 + math.sqrt(2)
HARMONICS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # of the curves, in the order in which they are tried
MOST_HARMONICS = 0.25  # per point of a contour, so that the curve cannot follow the terraces
# Distance of voxels from the curve on the wrong side, voxels. From 0.05 to 0.2, discs with radii of 10 to 150 voxels
# keep these chords; with 0.02, they have an SD of 0.10 to 0.20 voxels.
MOST_CONTRADICTION = 0.1
SMOOTHED_POINTS = 3.0  # SD of the Gaussian that makes the length along a contour independent of terraces, points
POINTS = 4  # of a curve, per point of the contour
# Variance of the attenuation in a voxel that remains unknown, relative to that of a share of unknown size.
# - where no curve fits: with 0.5, the two edges of a ray have an SD of 0.33 voxels (0.22 to 0.28 measured, see SIGMA)
# - of a curve: per coefficient and point of the contour, and of any curve. Chords of discs with radii of 2 to 50 voxels
#   have a variance of 0.18 x coefficients / points + 0.004 squared voxels (seed 5). Errors of a curve are smooth, so
#   that more rays vary together than terraces show (Edges.unknown). The variance is therefore multiplied by 3; with 1,
#   blur was named in four of 31 scans of labels with nothing hidden (opened seed 2647202001).
UNKNOWN, UNKNOWN_OF_COEFFICIENTS, UNKNOWN_OF_CURVE = 0.5, 2.5, 0.055
NEAR = 2  # voxels on either side of a surface that may have a partial volume
FAR = 1e3  # distance of voxels that are not near a surface, voxels
LEAST_SUM = 0.02  # of the shares of all materials in a voxel


@dataclass(frozen=True)
class Surfaces:
    """Surfaces of all materials of a volume.

    Attributes
    ----------
    near : ndarray of bool, shape (z, y, x)
        Voxels near a surface.
    distance : ndarray of float32, shape (materials + 1, near voxels)
        By material, as `distances`; the last one is of empty space.
    unknown : ndarray of float32, shape (near voxels,)
        Unknown part of the variance.
    """

    near: np.ndarray
    distance: np.ndarray
    unknown: np.ndarray

    @classmethod
    def of(cls, amounts: np.ndarray, contours: bool) -> Surfaces:
        """Return the surfaces of materials of which a voxel has one or none; `contours` as in `distances`."""
        empty = 1 - amounts.sum(axis=0, keepdims=True)
        found = [distances(share, contours) for share in np.concatenate([amounts, empty])]
        near = np.any([np.abs(distance) < FAR for distance, _ in found], axis=0)
        # Next to a surface without a curve, another material may have one.
        unknown = np.min([unknown[near] for _, unknown in found], axis=0)
        return cls(near, np.stack([distance[near] for distance, _ in found]), unknown)

    @property
    def unknown_field(self) -> np.ndarray:
        """Unknown part of the variance in all voxels, shape (z, y, x)."""
        found = np.full(self.near.shape, UNKNOWN, np.float32)
        found[self.near] = self.unknown
        return found


def shares_at(distance: np.ndarray) -> np.ndarray:
    """Return the shares of voxels that all materials and empty space fill, shaped as their distances."""
    found = np.clip(0.5 + distance, 0, 1)
    return found / np.maximum(found.sum(axis=0), LEAST_SUM)


def distances(share: np.ndarray, contours: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of each voxel from the surface, and the unknown part of its variance (UNKNOWN).

    Distances are positive inside, in voxels, and FAR or -FAR away from the surface. The surface is the curve of its
    section (`_curve_of`). Where no curve fits, or with `contours` false, it is where the smoothed share is 0.5. A
    Gaussian G lowers the share at a surface in proportion to its curvature and to its standard deviation, which G^2 has
    times sqrt(2). The smoothing (1 + a) G - a G^2 with a = SHARPENED therefore does not displace surfaces, to first
    order in their curvature.

    Parameters
    ----------
    share : ndarray, shape (z, y, x)
        1 for voxels of the material, else 0.
    """
    found = np.where(share > 0.5, FAR, -FAR).astype(np.float32)
    unknown = np.full(share.shape, UNKNOWN, np.float32)
    if not share.any():
        return found, unknown
    reach = math.ceil(2 * REACH * SIGMA)
    (filled,) = ndimage.find_objects((share > 0).astype(np.uint8))
    box = tuple(slice(max(0, side.start - reach), side.stop + reach) for side in filled)
    share = share[box]
    inside = share > 0.5
    axes = [axis for axis in range(3) if share.shape[axis] > 1]

    def blurred(values: np.ndarray) -> np.ndarray:
        return ndimage.gaussian_filter(values, SIGMA, axes=axes, mode="nearest", truncate=REACH)

    once = blurred(share)
    smooth = (1 + SHARPENED) * once - SHARPENED * blurred(once)
    slopes = {axis: np.gradient(smooth, axis=axis) for axis in axes}
    slope = np.sqrt(sum(along**2 for along in slopes.values()))
    there = slope > LEAST_SLOPE
    distance = found[box]  # a view
    distance[there] = (smooth[there] - 0.5) / slope[there]
    if contours:
        # The distance from an inclined surface is this share of the distance within the section.
        inclined = np.divide(np.hypot(slopes[1], slopes[2]), slope, out=np.ones_like(slope), where=there)
        for number, section in enumerate(inside):
            if not number or (section != inside[number - 1]).any():
                along, of_section = _distances(section)
                near = np.isfinite(along)
            distance[number, near] = inclined[number, near] * along[near]
            unknown[box][number] = of_section
    return found, unknown


def _distances(section: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances of voxels from the nearest contour that a curve describes, and the unknown part there.

    Distances are positive inside, in voxels, and infinite far from such contours. Contours that end at the border have
    no curve.
    """
    from skimage.measure import find_contours  # slow import

    found, shape = np.full(section.shape, np.inf), np.array(section.shape)
    unknown = np.full(section.shape, UNKNOWN, np.float32)
    for contour in find_contours(section.astype(float), 0.5):
        points = contour[:-1]
        if (contour[0] != contour[-1]).any():
            continue
        low = np.maximum(np.floor(points.min(axis=0)).astype(int) - NEAR, 0)
        high = np.minimum(np.ceil(points.max(axis=0)).astype(int) + NEAR + 1, shape)
        touched = np.zeros(high - low, bool)
        touched[tuple(np.round(points).astype(int).T - low[:, None])] = True
        next_to = np.argwhere(ndimage.binary_dilation(touched)) + low
        curve = _curve_of(points, next_to, section[tuple(next_to.T)])
        if curve is not None:
            voxels = np.argwhere(ndimage.binary_dilation(touched, iterations=NEAR)) + low
            at, distance = tuple(voxels.T), curve.distance(voxels)
            nearer = abs(distance) < abs(found[at])
            found[at] = np.where(nearer, distance, found[at])
            unknown[at] = np.where(nearer, curve.unknown, unknown[at])
    return found, unknown


@dataclass(frozen=True)
class _Curve:
    """A closed curve, as points and their normals toward the inside, shape (points, 2), and its unknown part."""

    points: np.ndarray
    normals: np.ndarray
    unknown: float

    @classmethod
    def of(cls, points: np.ndarray, length: np.ndarray, harmonics: int) -> _Curve:
        """Return the curve of a number of harmonics that fits points at lengths along it, from 0 to 1.

        Contours by scikit-image have the higher values, thus the inside, on one side.
        """
        waves = _waves(length, harmonics)
        coefficients = np.linalg.lstsq(waves, points, rcond=None)[0]
        places = _waves(np.arange(POINTS * len(points)) / (POINTS * len(points)), harmonics) @ coefficients
        along = np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)
        normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
        unknown = min(UNKNOWN, UNKNOWN_OF_COEFFICIENTS * coefficients.size / len(points) + UNKNOWN_OF_CURVE)
        return cls(places, normals / np.linalg.norm(normals, axis=1, keepdims=True), unknown)

    def distance(self, voxels: np.ndarray) -> np.ndarray:
        """Return the distance of voxels (voxels, 2) along the normal of the nearest point, positive inside."""
        _, nearest = cKDTree(self.points).query(voxels)
        return ((voxels - self.points[nearest]) * self.normals[nearest]).sum(axis=1)


def _waves(length: np.ndarray, harmonics: int) -> np.ndarray:
    """Return the waves of a Fourier series at lengths from 0 to 1, shape (lengths, 1 + 2 harmonics)."""
    phase = 2 * np.pi * np.outer(length, np.arange(1, 1 + harmonics))
    return np.hstack([np.ones((len(length), 1)), np.cos(phase), np.sin(phase)])


def _curve_of(points: np.ndarray, voxels: np.ndarray, inside: np.ndarray) -> _Curve | None:
    """Return the curve of the fewest harmonics that agrees with voxels; None if there is none.

    Parameters
    ----------
    points : ndarray, shape (points, 2)
        Contour along the borders of voxels.
    voxels : ndarray, shape (voxels, 2)
        Next to the contour.
    inside : ndarray of bool, shape (voxels,)
        Whether a voxel belongs to the material.
    """
    smooth = ndimage.gaussian_filter1d(points, SMOOTHED_POINTS, axis=0, mode="wrap")
    steps = np.linalg.norm(np.roll(smooth, -1, axis=0) - smooth, axis=1)
    length = (np.cumsum(steps) - steps) / steps.sum()
    for harmonics in HARMONICS:
        if harmonics > MOST_HARMONICS * len(points):
            break
        curve = _Curve.of(points, length, harmonics)
        distance = curve.distance(voxels)
        if np.where(inside, -distance, distance).max() <= MOST_CONTRADICTION:
            return curve
    return None
