"""Location of a known object in a plane of an image: center, and roll about z.

The search for the center starts from the center of a circle fitted to the surface, from the center of mass, and from
the center of the image. The roll is the angle at which the HU of the object correlate best with the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy import ndimage, optimize
from skimage import measure

from ..base.errors import InputError
from ..base.units import HU_AIR
from ..statistics.surface_resolution import SURFACE_HU
from .levels import SOFT_HU, clipped, correlation

LEAST_DEGREES = 180  # in which the surface is seen
SEARCHED = 0.15  # relative range around the known radius in which the surface is searched
OUTLIER = 3.0  # scaled median absolute deviations from which points of the surface are rejected
ITERATIONS = 5  # of fits of a center
ROLL_STEP_DEG = 0.5  # of the search for the roll, which is refined
POINTS_OF_STARTS = 3000  # of an object, by which the roll is searched
RIM_PIXELS = 3  # of air around the object that are compared, and inside its surface that are not
TOLERANCES = {"xatol": 1e-3, "fatol": 1e-9}  # mm and degrees of a location, and its correlation


def fit_circle(plane: np.ndarray, spacing: Sequence[float], radius: float) -> tuple[float, float, float]:
    """Return x and y of the center, and the radius, of the surface between air and an object, mm.

    Parameters
    ----------
    plane : ndarray, shape (y, x)
        HU.
    spacing : sequence of 3 float
        mm (z, y, x).
    radius : float
        Known radius, mm.

    Raises
    ------
    InputError
        If there is no circle of about this radius in the image.
    """
    contours = sorted(measure.find_contours(plane, SURFACE_HU), key=len) or [np.zeros((1, 2))]
    middle, steps = (np.array(plane.shape) - 1) / 2, np.array(spacing[1:])
    y, x = ((np.concatenate(contours) - middle) * steps).T
    center = ((contours[-1].mean(axis=0) - middle) * steps)[::-1]
    fitted = radius
    for _ in range(ITERATIONS):
        angle, distance = np.arctan2(y - center[1], x - center[0]), np.hypot(x - center[0], y - center[1])
        near = np.abs(distance / radius - 1) < SEARCHED
        if len(np.unique(np.degrees(angle[near]).round())) < LEAST_DEGREES:
            raise InputError(f"there is no round object with a diameter of {2 * radius:g} mm inside the image")
        left = np.abs(distance - np.median(distance[near]))
        near &= left <= max(OUTLIER * 1.4826 * np.median(left[near]), spacing[1] / 4)
        design = np.column_stack([2 * x, 2 * y, np.ones(len(x))])[near]
        *center, rest = np.linalg.lstsq(design, (x**2 + y**2)[near], rcond=None)[0]
        fitted = float(np.sqrt(rest + center[0] ** 2 + center[1] ** 2))
    return float(center[0]), float(center[1]), fitted


def best_roll(
    plane: np.ndarray, spacing: Sequence[float], center: Sequence[float], points: np.ndarray, hu: np.ndarray
) -> tuple[float, float]:
    """Return the largest correlation of the HU of an object with an image, and the roll in degrees that gives it.

    Parameters
    ----------
    points : ndarray of complex, shape (n,)
        Positions x + iy in the object, mm from its center.
    hu : ndarray, shape (n,)
        HU of the object there.
    """
    rolls = np.arange(0, 360, ROLL_STEP_DEG)
    wanted = hu - np.mean(hu)
    turned = np.exp(1j * np.radians(rolls))[:, None] * points
    values = at(plane, spacing, center[0] + turned.real, center[1] + turned.imag)
    values -= values.mean(axis=1, keepdims=True)
    scores = values @ wanted / np.maximum(np.linalg.norm(values, axis=1) * np.linalg.norm(wanted), 1e-9)
    return float(scores.max()), float(rolls[np.argmax(scores)])


class Found(NamedTuple):
    """Object in a plane.

    `location` holds x_mm and y_mm from the center of the image, and turn_deg. `fitted` is the object there, HU on the
    pixels of the image. It is correlated with the image, including a rim of air, and, with HU clipped to SOFT_HU,
    `inside` its surface; `contrast` is the SD of these HU.
    """

    location: dict[str, float]
    fitted: np.ndarray
    correlation: float
    inside: float
    contrast: float


def find(plane: np.ndarray, spacing: Sequence[float], drawn: np.ndarray, drawn_spacing: Sequence[float]) -> Found:
    """Locate an object in an image.

    Parameters
    ----------
    plane, drawn : ndarray, shape (y, x)
        HU of the image and of the object.
    spacing, drawn_spacing : sequence of 3 float
        mm (z, y, x).

    Raises
    ------
    InputError
        If the object is as thin as air.
    """
    grids = (plane.shape, spacing), (drawn.shape, drawn_spacing)
    pixels, points = (x + 1j * y for x, y, _ in (around(*grid, (0.0, 0.0)) for grid in grids))
    body, dense = points[drawn > SURFACE_HU], pixels[plane > SURFACE_HU]
    if not len(body):
        raise InputError(f"object: no voxel is above {SURFACE_HU:g} HU, so it cannot be located in images")
    middle = body.mean()
    radius = float(np.sqrt(2 * np.mean(np.abs(body - middle) ** 2)))
    centers = [middle, *([dense.mean()] if len(dense) else [])]
    with suppress(InputError):  # not a circle
        centers.append(complex(*fit_circle(plane, spacing, radius)[:2]))
    # Pixels of the image are means over their area. Even sides would displace the object.
    sides = [
        2 * max(0, round((pixel / fine - 1) / 2)) + 1
        for pixel, fine in zip(spacing[1:], drawn_spacing[1:], strict=True)
    ]
    image, drawn = clipped(plane), ndimage.uniform_filter(clipped(drawn), sides)
    few = slice(None, None, max(1, len(body) // POINTS_OF_STARTS))
    near = np.abs(points - middle) < radius
    known = points[near][few] - middle, drawn[near][few]
    starts = [(*best_roll(image, spacing, (one.real, one.imag), *known), (one.real, one.imag)) for one in centers]
    _, roll, start = max(starts)

    def fitted(location: Sequence[float], where: np.ndarray) -> np.ndarray:
        there = (where - complex(*location[:2])) * np.exp(-1j * np.radians(location[2])) + middle
        return at(drawn, drawn_spacing, there.real, there.imag)

    begin = np.array([*start, roll])
    body = ndimage.binary_fill_holes(fitted(begin, pixels) > SURFACE_HU)
    compared = ndimage.binary_dilation(body, iterations=RIM_PIXELS)
    inside = ndimage.binary_erosion(body, iterations=RIM_PIXELS)[compared]
    inside |= not inside.any()
    where, seen = pixels[compared], image[compared]

    def correlations(location: Sequence[float]) -> tuple[float, float]:
        there = fitted(location, where)
        soft = (np.clip(part[inside], *SOFT_HU) for part in (there, seen))
        return correlation(there, seen), correlation(*soft)

    simplex = begin + np.vstack([np.zeros(3), np.diag([spacing[2], spacing[1], np.degrees(spacing[1] / radius)])])
    options = TOLERANCES | {"initial_simplex": simplex}
    best = optimize.minimize(lambda at: -sum(correlations(at)), begin, method="Nelder-Mead", options=options)
    contrast = float(np.std(np.clip(fitted(best.x, where[inside]), *SOFT_HU)))
    center = complex(*best.x[:2]) - middle * np.exp(1j * np.radians(best.x[2]))
    location = {"x_mm": center.real, "y_mm": center.imag, "turn_deg": (best.x[2] + 180) % 360 - 180}
    location = {key: float(value) for key, value in location.items()}
    return Found(location, fitted(best.x, pixels), *correlations(best.x), contrast)


def at(plane: np.ndarray, spacing: Sequence[float], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a plane (y, x) at positions in mm from its center, linearly interpolated; air outside."""
    rows, columns = (
        position / step + (n - 1) / 2 for position, step, n in zip((y, x), spacing[1:], plane.shape, strict=True)
    )
    return ndimage.map_coordinates(plane, [rows, columns], order=1, mode="constant", cval=HU_AIR)


def around(
    shape: Sequence[int], spacing: Sequence[float], center: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, y and distance of all pixels of a plane from a point (x, y), mm; spacing (z, y, x)."""
    rows, columns = ((np.arange(n) - (n - 1) / 2) * s for n, s in zip(shape, spacing[1:], strict=True))
    x, y = np.broadcast_arrays(columns - center[0], (rows - center[1])[:, None])
    return x, y, np.hypot(x, y)
