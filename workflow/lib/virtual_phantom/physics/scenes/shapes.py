"""Objects of geometric shapes with a material each: path lengths in closed form.

There are no voxels whose size could matter, and edges are as sharp as they were machined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.errors import InputError
from ...base.geometry import ScanGeometry
from ...base.pose import turned_axes
from ...projectors.chords import Room, Shapes, chords
from ...projectors.threads import share_out
from ..beam.materials import Material, attenuation_per_mm
from .scene import DISC_ENERGY_KEV, IN_PLACE, Pose, turned_back

NOTHING = "nothing"  # the material of a hole: no attenuation, as the air around
MARGIN_MM = 1e-3  # by which what lies around a shape is wider than it: more than rounding where the source is far away


@dataclass(frozen=True)
class Shape:
    """A convex shape of one material, in mm from the isocentre.

    Attributes
    ----------
    material : str or Mixture
        Of materials.COMPOUNDS or ELEMENTS, or NOTHING, or one of its own.
    planes : ndarray, shape (planes, 4)
        Unit normals and offsets: it lies behind all of them, normal . x <= offset.
    quadric : ndarray, shape (4, 4), or None
        It lies where (x, y, z, 1) M (x, y, z, 1)' <= 0.
    around : tuple of 5 float
        An upright cylinder around it: x, y and radius, from z to z, mm.
    """

    material: Material
    planes: np.ndarray
    quadric: np.ndarray | None = None
    around: tuple[float, float, float, float, float] = (0.0, 0.0, np.inf, -np.inf, np.inf)


def half_space(material: Material, point_mm: Sequence[float], outwards: Sequence[float]) -> Shape:
    """All that lies behind a plane.

    Parameters
    ----------
    point_mm : sequence of 3 float
        Of the plane, mm.
    outwards : sequence of 3 float
        Direction across it, out of the half-space.

    Raises
    ------
    InputError
        For a direction of no length.
    """
    normal = _unit(outwards, "half_space")
    return Shape(material, np.array([[*normal, normal @ np.asarray(point_mm, float)]]))


def box(material: Material, centre_mm: Sequence[float], sides_mm: Sequence[float], turn_deg: float = 0.0) -> Shape:
    """A box.

    Parameters
    ----------
    centre_mm, sides_mm : sequence of 3 float
        Middle and lengths of the edges along its own x, y and z, mm.
    turn_deg : float, optional
        About z, from +x to +y, degrees.

    Raises
    ------
    InputError
        For a side that is not positive.
    """
    _positive(sides_mm, "box", "sides_mm")
    centre = np.asarray(centre_mm, float)
    planes = [
        [*(side * axis), side * axis @ centre + length / 2]
        for axis, length in zip(turned_axes(turn_deg), sides_mm, strict=True)
        for side in (1, -1)
    ]
    return Shape(material, np.array(planes), around=_around(centre, np.hypot(*sides_mm[:2]) / 2, sides_mm[2] / 2))


def ellipsoid(
    material: Material, centre_mm: Sequence[float], half_axes_mm: Sequence[float], turn_deg: float = 0.0
) -> Shape:
    """An ellipsoid; a ball where the half-axes are equal.

    Parameters
    ----------
    centre_mm, half_axes_mm : sequence of 3 float
        Middle, and half-axes along its own x, y and z, mm.
    turn_deg : float, optional
        About z, from +x to +y, degrees.

    Raises
    ------
    InputError
        For a half-axis that is not positive.
    """
    _positive(half_axes_mm, "ellipsoid", "half_axes_mm")
    over = turned_axes(turn_deg) / np.asarray(half_axes_mm, float)[:, None]
    around = _around(centre_mm, max(half_axes_mm[:2]), half_axes_mm[2])
    return Shape(material, np.empty((0, 4)), _quadric(over.T @ over, centre_mm, -1.0), around)


def cylinder(
    material: Material,
    centre_mm: Sequence[float],
    radius_mm: float,
    length_mm: float | None = None,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
) -> Shape:
    """A round cylinder.

    Parameters
    ----------
    centre_mm : sequence of 3 float
        Middle, mm.
    length_mm : float, optional
        Along its axis, mm; None: without ends.
    axis : sequence of 3 float, optional
        Its direction.

    Raises
    ------
    InputError
        For a radius or length that is not positive, or an axis of no length.
    """
    _positive([radius_mm, *([] if length_mm is None else [length_mm])], "cylinder", "radius_mm and length_mm")
    along = _unit(axis, "cylinder")
    matrix = np.eye(3) - np.outer(along, along)
    ends = np.empty((0, 4)) if length_mm is None else _ends(along, centre_mm, -length_mm / 2, length_mm / 2)
    around = _around_axis(along, centre_mm, np.inf if length_mm is None else length_mm / 2, radius_mm)
    return Shape(material, ends, _quadric(matrix, centre_mm, -(radius_mm**2)), around)


def cone(
    material: Material,
    base_mm: Sequence[float],
    base_radius_mm: float,
    top_radius_mm: float,
    height_mm: float,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
) -> Shape:
    """A round cone, cut off where it has the radius of its top.

    Parameters
    ----------
    base_mm : sequence of 3 float
        Middle of its base, mm.
    base_radius_mm, top_radius_mm : float
        Radii, mm; the top's is smaller, and 0 where it ends in a point.
    height_mm : float
        From base to top, mm.
    axis : sequence of 3 float, optional
        Direction from base to top.

    Raises
    ------
    InputError
        For radii or a height that make no cone, or an axis of no length.
    """
    _positive([base_radius_mm, height_mm], "cone", "base_radius_mm and height_mm")
    if not 0 <= top_radius_mm < base_radius_mm:
        raise InputError(
            f"cone: top_radius_mm {top_radius_mm:g} must be from 0 to less than base_radius_mm {base_radius_mm:g}; of "
            "equal radii it is a cylinder"
        )
    along, slope = _unit(axis, "cone"), (base_radius_mm - top_radius_mm) / height_mm
    apex = np.asarray(base_mm, float) + along * base_radius_mm / slope
    matrix = np.eye(3) - (1 + slope**2) * np.outer(along, along)
    middle = np.asarray(base_mm, float) + along * height_mm / 2
    around = _around_axis(along, middle, height_mm / 2, base_radius_mm)
    return Shape(material, _ends(along, base_mm, 0.0, height_mm), _quadric(matrix, apex, 0.0), around)


class ShapesScene:
    """What VoxelScene is, of shapes.

    Parameters
    ----------
    shapes : sequence of Shape
        Later ones replace earlier ones where both are.
    energy_kev : float, optional
        Of the monochromatic beam, keV.

    Raises
    ------
    InputError
        If there is no shape, or none of a material.
    """

    def __init__(self, shapes: Sequence[Shape], energy_kev: float = DISC_ENERGY_KEV, threads: int = 1):
        self.materials = tuple(dict.fromkeys(one.material for one in shapes if one.material != NOTHING))
        if not self.materials:
            raise InputError(f"shapes: there is none of a material; give one that is not '{NOTHING}'")
        self.energy_kev, self.threads = energy_kev, threads
        index = {name: place for place, name in enumerate(self.materials)} | {NOTHING: -1}
        none = np.zeros((4, 4))
        self._shapes = Shapes(
            planes=np.concatenate([one.planes for one in shapes]),
            first_plane=np.cumsum([0, *(len(one.planes) for one in shapes)]),
            quadrics=np.stack([_packed(none if one.quadric is None else one.quadric) for one in shapes]),
            curved=np.array([one.quadric is not None for one in shapes]),
            material=np.array([index[one.material] for one in shapes]),
            around=np.array([one.around for one in shapes], float),
        )

    @property
    def radius_mm(self) -> float:
        """How far it reaches from the z axis at most, mm."""
        x, y, radius = self._shapes.around.T[:3]
        return float((np.hypot(x, y) + radius).max())

    @property
    def attenuation_per_mm(self) -> np.ndarray:
        """Of each material at the monochromatic energy, 1/mm, shape (materials,)."""
        return np.array([attenuation_per_mm(material, [self.energy_kev])[0] for material in self.materials])

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As VoxelScene.path_lengths."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        # In the object's own size and place.
        sources = np.ascontiguousarray((geometry.source_mm - shift) / pose.size)
        to, rises = geometry.bundles()
        ways, rises = np.ascontiguousarray(np.moveaxis(to, 0, -1)) / pose.size, rises / pose.size
        lengths = np.zeros((len(self.materials), len(sources), len(rises), ways.shape[1]), np.float32)

        def run(first, last):
            part = sources[first:last], ways[first:last], rises, float(pose.size), lengths[:, first:last]
            chords(self._shapes, *part, Room.of(self._shapes))

        share_out(run, len(sources), self.threads)
        return lengths.reshape(-1, *geometry.shape)


def _quadric(matrix: np.ndarray, centre_mm: Sequence[float], constant: float) -> np.ndarray:
    """(x - centre) . matrix (x - centre) + constant, as a (4, 4) matrix of (x, y, z, 1)."""
    centre = np.asarray(centre_mm, float)
    whole = np.empty((4, 4))
    whole[:3, :3] = matrix
    whole[:3, 3] = whole[3, :3] = -matrix @ centre
    whole[3, 3] = centre @ matrix @ centre + constant
    return whole


def _packed(quadric: np.ndarray) -> np.ndarray:
    """As Shapes.quadrics has it."""
    return np.array(
        [*np.diag(quadric)[:3], quadric[0, 1], quadric[0, 2], quadric[1, 2], *quadric[:3, 3], quadric[3, 3]]
    )


def _ends(along: np.ndarray, point_mm: Sequence[float], low_mm: float, high_mm: float) -> np.ndarray:
    """Planes across an axis, so far from a point along it."""
    at = float(along @ np.asarray(point_mm, float))
    return np.array([[*along, at + high_mm], [*-along, -(at + low_mm)]])


def _around(centre_mm: Sequence[float], radius_mm: float, half_height_mm: float) -> tuple[float, ...]:
    """As Shape.around."""
    x, y, z = map(float, centre_mm)
    half = half_height_mm + MARGIN_MM
    return x, y, float(radius_mm) + MARGIN_MM, z - half, z + half


def _around_axis(along: np.ndarray, middle_mm: Sequence[float], half_mm: float, radius_mm: float) -> tuple[float, ...]:
    """As Shape.around, of what lies within a radius of an axis, to so far from its middle."""
    level, up = float(np.hypot(*along[:2])), abs(float(along[2]))
    # An axis without end, where its part is 0, adds nothing.
    reach, height = (half_mm * part if part > 0 else 0.0 for part in (level, up))
    return _around(middle_mm, reach + radius_mm, height + radius_mm * level)


def _unit(direction: Sequence[float], where: str) -> np.ndarray:
    direction = np.asarray(direction, float)
    length = np.linalg.norm(direction)
    if not length > 0:
        raise InputError(f"{where}: the direction {direction.tolist()} has no length; give another")
    return direction / length


def _positive(values: Sequence[float], where: str, key: str) -> None:
    if not all(value > 0 for value in values):
        raise InputError(f"{where}: {key} must be positive, not {', '.join(f'{value:g}' for value in values)}")
