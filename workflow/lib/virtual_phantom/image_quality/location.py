"""Location of an object of shapes in images: center, roll, orientation, and the position of each insert.

The axis of the object is taken to be nearly along z. The center in each slice is that of a circle fitted to the
surface. The roll is the angle at which the nominal HU of the inserts correlate best with the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.stats import median_abs_deviation

from ..base.errors import InputError
from ..physics.beam.materials import Material, attenuation_per_mm
from ..physics.scenes.objects import ShapedObject
from ..physics.scenes.shapes import MARGIN_MM, NOTHING, Shape
from ..statistics.surface_resolution import SURFACE_HU

RAYS = 360  # directions in which the surface is searched
SEARCHED = 0.15  # relative range around the known radius in which the surface is searched
OUTLIER = 3.0  # scaled median absolute deviations from which points of the surface are rejected
ITERATIONS = 5  # of fits of a center
ROLL_STEP_DEG = 0.5
LEAST_CORRELATION = 0.9  # between nominal HU of inserts and the image, for an object that is found
LEAST_MEDIUM_MM = 20.0  # radius of the cylinder that can contain inserts
LEAST_CONTRAST = 1.0  # of an insert relative to noise, from which its center is fitted
LEAST_WINDOW_VOXELS = 3.0  # radius of the window about an insert
BETWEEN = 24  # points in the medium, at the distance of each insert from the axis, that are compared too
SMOOTHED_MM = 2.0  # side of the squares that are averaged to find the roll
NOISE_MARGIN_MM = 8.0  # of uniform areas from inserts and from the border of the medium
REFERENCE_KEV = 70.0  # energy of nominal HU, as in the manuals of phantoms


@dataclass(frozen=True)
class Insert:
    """A cylinder along z inside the medium of the object; position in mm from the axis."""

    name: str
    material: Material
    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Layout:
    """Cylinders along z of an object.

    Attributes
    ----------
    medium : Material
        Material of the innermost cylinder around the axis.
    medium_radius, body_radius : float
        mm.
    """

    medium: Material
    medium_radius: float
    body_radius: float
    inserts: tuple[Insert, ...]


@dataclass(frozen=True)
class Location:
    """Object in an image.

    Attributes
    ----------
    centers : ndarray, shape (slices, 2)
        Center (x, y) of the object in each slice, mm from the center of the grid; on a line.
    radius : float
        Fitted radius of the surface, mm.
    roll_deg, mirrored
        The object is mirrored in x, if seen from its other end, and then rotated about z.
    inserts : tuple of Insert
        As found in the image, relative to the center.
    """

    centers: np.ndarray
    radius: float
    roll_deg: float = 0.0
    mirrored: bool = False
    inserts: tuple[Insert, ...] = ()


def nominal_hu(material: Material, energy_kev: float = REFERENCE_KEV) -> float:
    """Return the HU of a material in a monochromatic beam."""
    if material == NOTHING:
        return -1000.0
    mu, water = (attenuation_per_mm(one, [energy_kev])[0] for one in (material, "water"))
    return 1000 * float(mu / water - 1)


def layout(shaped: ShapedObject) -> Layout:
    """Return the cylinders of an object.

    Raises
    ------
    InputError
        If no cylinder along z surrounds the axis.
    """
    cylinders = [
        (name or str(shape.material), shape.material, *shape.around[:2], shape.around[2] - MARGIN_MM)
        for name, shape in zip(shaped.names, shaped.shapes, strict=True)
        if along_z(shape)
    ]
    around = [i for i, (_, _, x, y, r) in enumerate(cylinders) if r >= LEAST_MEDIUM_MM and np.hypot(x, y) < r / 2]
    if not around:
        raise InputError(f"object {shaped.name}: has no cylinder along z around its axis; image quality needs one")
    _, medium, _, _, radius = cylinders[around[-1]]
    inserts = [Insert(*one) for one in cylinders[around[-1] + 1 :]]
    body = max(cylinders[i][4] for i in around)
    return Layout(medium, radius, body, tuple(one for one in inserts if np.hypot(one.x, one.y) + one.radius < radius))


def along_z(shape: Shape) -> bool:
    """Return whether a shape is a circular cylinder along z."""
    return shape.quadric is not None and np.allclose(shape.quadric[:3, :3], np.diag([1.0, 1.0, 0.0]), atol=1e-9)


def fit_circle(plane: np.ndarray, spacing: Sequence[float], radius: float) -> tuple[float, float, float]:
    """Return x and y of the center, and the radius, of the surface between air and an object, mm.

    Parameters
    ----------
    plane : ndarray, shape (y, x)
        HU.
    spacing : sequence of 3 float
        mm (z, y, x).
    radius : float
        Known radius, mm. In each direction, the surface nearest to it is used, to avoid a couch.

    Raises
    ------
    InputError
        If there is no circle of about this radius in the image.
    """
    regions, _ = ndimage.label(plane > SURFACE_HU)
    largest = regions == np.argmax(np.bincount(regions.ravel())[1:]) + 1 if regions.any() else regions
    x, y, _ = around(plane.shape, spacing, (0.0, 0.0))
    cx, cy, fitted = (float(v[largest].mean()) if regions.any() else 0.0 for v in (x, y, np.full(x.shape, radius)))
    angles = np.arange(RAYS) * 2 * np.pi / RAYS
    step = min(spacing[1:]) / 4
    reach = np.arange((1 - SEARCHED) * radius, (1 + SEARCHED) * radius, step)
    for _ in range(ITERATIONS):
        values = at(plane, spacing, cx + np.outer(np.cos(angles), reach), cy + np.outer(np.sin(angles), reach))
        leaves = (values[:, :-1] > SURFACE_HU) & (values[:, 1:] <= SURFACE_HU)
        distance = np.where(leaves, np.abs(reach[:-1] - radius), np.inf)
        chosen, index = np.argmin(distance, axis=1), np.flatnonzero(leaves.any(axis=1))
        if len(index) < RAYS / 2:
            raise InputError(f"image quality: there is no round object of {2 * radius:g} mm inside the image")
        inner, outer = values[index, chosen[index]], values[index, chosen[index] + 1]
        found = reach[chosen[index]] + (inner - SURFACE_HU) / (inner - outer) * step
        x, y = found * np.cos(angles[index]), found * np.sin(angles[index])
        kept = np.abs(found - np.median(found)) <= max(OUTLIER * 1.4826 * median_abs_deviation(found), step)
        design = np.column_stack([2 * x, 2 * y, np.ones(len(x))])[kept]
        dx, dy, rest = np.linalg.lstsq(design, (x**2 + y**2)[kept], rcond=None)[0]
        cx, cy, fitted = cx + dx, cy + dy, float(np.sqrt(rest + dx**2 + dy**2))
    return float(cx), float(cy), fitted


def locate(images: np.ndarray, spacing: Sequence[float], known: Layout) -> Location:
    """Locate an object of shapes in all slices together.

    Parameters
    ----------
    images : ndarray, shape (z, y, x)
        HU.
    spacing : sequence of 3 float
        mm (z, y, x).

    Raises
    ------
    InputError
        If the surface or the inserts are not found.
    """
    circles = np.array([fit_circle(plane, spacing, known.body_radius) for plane in images])
    z = np.arange(len(images)) - (len(images) - 1) / 2
    centers = np.column_stack([np.polyval(np.polyfit(z, circles[:, i], min(1, len(z) - 1)), z) for i in (0, 1)])
    found = Location(centers, float(np.median(circles[:, 2])))
    if not known.inserts:
        return found
    mean, middle = images.mean(axis=0), centers.mean(axis=0)
    score, roll, mirrored = best_roll(mean, spacing, middle, known)
    if score < LEAST_CORRELATION:
        raise InputError(
            f"image quality: the inserts are not found (correlation {score:.2f}); check the object and its slices"
        )
    for _ in range(2):  # wires are searched near positions that the larger inserts give
        nominal = [_turned(one, roll, mirrored) for one in known.inserts]
        seen = tuple(
            _centered(mean, spacing, middle, replace(one, x=position.real, y=position.imag))
            for one, position in zip(known.inserts, nominal, strict=True)
        )
        # Least-squares rotation between nominal and measured positions, weighted by area
        pairs = zip(seen, nominal, strict=True)
        turn = sum(one.radius**2 * complex(one.x, one.y) * position.conjugate() for one, position in pairs)
        roll += float(np.degrees(np.angle(turn)))
    return replace(found, roll_deg=roll, mirrored=mirrored, inserts=seen)


def best_roll(
    plane: np.ndarray, spacing: Sequence[float], center: Sequence[float], known: Layout
) -> tuple[float, float, bool]:
    """Return the largest correlation of nominal HU with the image, and the roll and orientation that give it.

    It includes points between the inserts.
    """
    # The HU of a thin wire depend on the blur.
    inserts = [one for one in known.inserts if one.radius >= SMOOTHED_MM / 2] or known.inserts
    positions = np.array([complex(one.x, one.y) for one in inserts])
    radii = np.array([one.radius for one in inserts])
    between = (np.abs(positions)[:, None] * np.exp(2j * np.pi * np.arange(BETWEEN) / BETWEEN)).ravel()
    clear = (np.abs(between[:, None] - positions) > 1.5 * radii + SMOOTHED_MM).all(axis=1)
    positions = np.append(positions, between[clear])
    values = [nominal_hu(one.material) for one in inserts] + [nominal_hu(known.medium)] * int(clear.sum())
    wanted = np.array(values) - np.mean(values)
    rolls = np.arange(0, 360, ROLL_STEP_DEG)
    smooth = ndimage.uniform_filter(plane, max(1, int(SMOOTHED_MM / max(spacing[1:]))))
    best = (-1.0, 0.0, False)
    for mirrored in (False, True):
        turned = np.exp(1j * np.radians(rolls))[:, None] * (-positions.conjugate() if mirrored else positions)
        values = at(smooth, spacing, center[0] + turned.real, center[1] + turned.imag)
        values -= values.mean(axis=1, keepdims=True)
        scores = values @ wanted / np.maximum(np.linalg.norm(values, axis=1) * np.linalg.norm(wanted), 1e-9)
        best = max(best, (float(scores.max()), float(rolls[np.argmax(scores)]), mirrored))
    return best


def _turned(one: Insert, roll_deg: float, mirrored: bool) -> complex:
    """Return the position x + iy of an insert in an object that is mirrored and rotated."""
    return complex(-one.x if mirrored else one.x, one.y) * np.exp(1j * np.radians(roll_deg))


def _centered(plane: np.ndarray, spacing: Sequence[float], center: Sequence[float], one: Insert) -> Insert:
    """Return an insert at the centroid of its contrast, if that is strong enough; otherwise as it is."""
    radius = max(one.radius, LEAST_WINDOW_VOXELS * max(spacing[1:]))
    for _ in range(ITERATIONS):
        x, y, distance = around(plane.shape, spacing, (center[0] + one.x, center[1] + one.y))
        ring = (distance > 1.3 * radius) & (distance < 1.6 * radius)
        signal = (plane - np.median(plane[ring])) * (distance < 1.3 * radius)
        contrast = signal[distance < one.radius].mean() if radius == one.radius else np.abs(signal).max() / 3
        if abs(contrast) < LEAST_CONTRAST * plane[ring].std():
            return one
        dx, dy = (float((signal * axis).sum() / signal.sum()) for axis in (x, y))
        one = replace(one, x=one.x + dx, y=one.y + dy)
    return one


def at(plane: np.ndarray, spacing: Sequence[float], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a plane (y, x) at positions in mm from its center, linearly interpolated; air outside."""
    rows, columns = (
        position / step + (n - 1) / 2 for position, step, n in zip((y, x), spacing[1:], plane.shape, strict=True)
    )
    return ndimage.map_coordinates(plane, [rows, columns], order=1, mode="constant", cval=-1000.0)


def around(
    shape: Sequence[int], spacing: Sequence[float], center: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, y and distance of all pixels of a plane from a point (x, y), mm; spacing (z, y, x)."""
    rows, columns = ((np.arange(n) - (n - 1) / 2) * s for n, s in zip(shape, spacing[1:], strict=True))
    x, y = np.broadcast_arrays(columns - center[0], (rows - center[1])[:, None])
    return x, y, np.hypot(x, y)
