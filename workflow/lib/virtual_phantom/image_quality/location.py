"""Location of an object of shapes in images: center, roll, orientation, and the position of each insert.

The axis of the object is taken to be nearly along z. The center in each slice is that of a circle fitted to the
surface. The roll is the angle at which the nominal HU of the inserts correlate best with the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..base.errors import InputError
from ..physics.beam.materials import Material, attenuation_per_mm
from ..physics.scenes.objects import ShapedObject
from ..physics.scenes.shapes import MARGIN_MM, NOTHING, Shape
from ..recordings.in_plane import around, best_roll, fit_circle

ITERATIONS = 5  # of the center of an insert
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
    score, roll, mirrored = roll_of_inserts(mean, spacing, middle, known)
    if score < LEAST_CORRELATION:
        raise InputError(
            f"image quality: the inserts are not found (correlation {score:.2f}); check the object and its slices"
        )
    for _ in range(2):  # wires are searched near positions that the larger inserts give
        nominal = [turned(one.x, one.y, roll, mirrored) for one in known.inserts]
        seen = tuple(
            _centered(mean, spacing, middle, replace(one, x=position.real, y=position.imag))
            for one, position in zip(known.inserts, nominal, strict=True)
        )
        # Least-squares rotation between nominal and measured positions, weighted by area
        pairs = zip(seen, nominal, strict=True)
        turn = sum(one.radius**2 * complex(one.x, one.y) * position.conjugate() for one, position in pairs)
        roll += float(np.degrees(np.angle(turn)))
    return replace(found, roll_deg=roll, mirrored=mirrored, inserts=seen)


def roll_of_inserts(
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
    points = np.append(positions, between[clear])
    hu = np.array([nominal_hu(one.material) for one in inserts] + [nominal_hu(known.medium)] * int(clear.sum()))
    smooth = ndimage.uniform_filter(plane, max(1, int(SMOOTHED_MM / max(spacing[1:]))))
    views = ((points, False), (-points.conjugate(), True))
    return max((*best_roll(smooth, spacing, center, seen, hu), mirrored) for seen, mirrored in views)


def turned(x: float, y: float, roll_deg: float, mirrored: bool) -> complex:
    """Return x + iy of a position or direction in an object that is mirrored and rotated."""
    return complex(-x if mirrored else x, y) * np.exp(1j * np.radians(roll_deg))


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
