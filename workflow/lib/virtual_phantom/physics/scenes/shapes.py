"""Objects of geometric shapes with one material each, with path lengths in closed form.

There is no voxel size, and edges are ideally sharp.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import InputError
from ...base.geometry import ScanGeometry
from ...base.pose import IN_PLACE, Pose, turned_axes, turned_back
from ...projectors.chords import Shapes, Workspace, chords
from ...projectors.threads import run_in_threads
from ..beam.materials import Material, energy_of
from .edges import EdgeScan, edge_scans
from .scene import DISC_ENERGY_KEV, Scene

NOTHING = "nothing"  # material of a hole: no attenuation, like the air around the object
ROUNDING = 1e-9  # eigenvalues below this share are zero: directions without a limit
ROOM = 4.0  # growth of Shape.around over that of the surface, for corners
MARGIN_MM = 1e-3  # margin of Shape.around: more than rounding errors for a distant source


@dataclass(frozen=True)
class Shape:
    """A convex shape of one material, in mm from the isocenter.

    Attributes
    ----------
    material : str or Mixture
        Name in materials.COMPOUNDS or ELEMENTS, NOTHING, or another material.
    planes : ndarray, shape (planes, 4)
        Unit normals n and offsets d: points x in the shape have n . x <= d for all planes.
    quadric : ndarray, shape (4, 4), or None
        Points in the shape have (x, y, z, 1) M (x, y, z, 1)' <= 0.
    around : tuple of 5 float
        Bounding cylinder along z: x, y, radius, lowest and highest z, mm.
    """

    material: Material
    planes: np.ndarray
    quadric: np.ndarray | None = None
    around: tuple[float, float, float, float, float] = (0.0, 0.0, np.inf, -np.inf, np.inf)

    def grown(self, by_mm: float) -> Shape:
        """Return the shape with its surface displaced outwards by a small distance, or inwards by a negative one.

        Ellipsoids grow to first order: each semi-axis by the distance.
        """
        planes = self.planes + [0, 0, 0, by_mm]
        x, y, radius, low, high = self.around
        more = ROOM * max(by_mm, 0.0)  # a smaller one need not have a smaller bound
        around = (x, y, radius + more, low - more, high + more)
        if self.quadric is None:
            return replace(self, planes=planes, around=around)
        matrix, center = self.quadric[:3, :3], -np.linalg.pinv(self.quadric[:3, :3]) @ self.quadric[:3, 3]
        constant = self.quadric[3, 3] + self.quadric[3, :3] @ center
        values, axes = np.linalg.eigh(matrix)
        if values[0] < -ROUNDING:  # a cone, whose apex moves along its axis
            slope = np.sqrt(-values[0])
            quadric = _quadric(matrix, center + self.planes[0, :3] * by_mm * np.hypot(1, slope) / slope, 0.0)
        else:
            half = np.sqrt(-constant / np.where(values > ROUNDING * values[2], values, np.inf))
            squares = np.divide(1, (half + by_mm) ** 2, out=np.zeros(3), where=half > 0)
            quadric = _quadric((axes * squares) @ axes.T, center, -1.0)
        return replace(self, planes=planes, quadric=quadric, around=around)


def half_space(material: Material, point_mm: Sequence[float], outwards: Sequence[float]) -> Shape:
    """Return a half-space.

    Parameters
    ----------
    point_mm : sequence of 3 float
        A point of its plane, mm.
    outwards : sequence of 3 float
        Outward normal, of any length.

    Raises
    ------
    InputError
        If the normal is zero.
    """
    normal = _unit(outwards, "half_space")
    return Shape(material, np.array([[*normal, normal @ np.asarray(point_mm, float)]]))


def box(material: Material, centre_mm: Sequence[float], sides_mm: Sequence[float], turn_deg: float = 0.0) -> Shape:
    """Return a box.

    Parameters
    ----------
    centre_mm, sides_mm : sequence of 3 float
        Center, and side lengths along its own x, y and z, mm.
    turn_deg : float, optional
        Rotation about z, from +x to +y, degrees.

    Raises
    ------
    InputError
        If a side is not positive.
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
    material: Material, centre_mm: Sequence[float], semi_axes_mm: Sequence[float], turn_deg: float = 0.0
) -> Shape:
    """Return an ellipsoid.

    Parameters
    ----------
    centre_mm, semi_axes_mm : sequence of 3 float
        Center, and semi-axes along its own x, y and z, mm.
    turn_deg : float, optional
        Rotation about z, from +x to +y, degrees.

    Raises
    ------
    InputError
        If a semi-axis is not positive.
    """
    _positive(semi_axes_mm, "ellipsoid", "semi_axes_mm")
    over = turned_axes(turn_deg) / np.asarray(semi_axes_mm, float)[:, None]
    around = _around(centre_mm, max(semi_axes_mm[:2]), semi_axes_mm[2])
    return Shape(material, np.empty((0, 4)), _quadric(over.T @ over, centre_mm, -1.0), around)


def cylinder(
    material: Material,
    centre_mm: Sequence[float],
    radius_mm: float,
    length_mm: float | None = None,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
) -> Shape:
    """Return a circular cylinder.

    Parameters
    ----------
    centre_mm : sequence of 3 float
        Center, mm.
    length_mm : float, optional
        Length along the axis, mm; None: infinite.
    axis : sequence of 3 float, optional
        Direction of the axis.

    Raises
    ------
    InputError
        If the radius or the length is not positive, or the axis is zero.
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
    """Return a circular cone or truncated cone.

    Parameters
    ----------
    base_mm : sequence of 3 float
        Center of the base, mm.
    base_radius_mm, top_radius_mm : float
        Radii, mm; the top is smaller than the base, and 0 for a full cone.
    height_mm : float
        Height from base to top, mm.
    axis : sequence of 3 float, optional
        Direction from base to top.

    Raises
    ------
    InputError
        If radii and height are not those of a cone, or the axis is zero.
    """
    _positive([base_radius_mm, height_mm], "cone", "base_radius_mm and height_mm")
    if not 0 <= top_radius_mm < base_radius_mm:
        raise InputError(
            f"cone: top_radius_mm {top_radius_mm:g} must be from 0 to less than base_radius_mm {base_radius_mm:g}; use "
            "a cylinder for equal radii"
        )
    along, slope = _unit(axis, "cone"), (base_radius_mm - top_radius_mm) / height_mm
    apex = np.asarray(base_mm, float) + along * base_radius_mm / slope
    matrix = np.eye(3) - (1 + slope**2) * np.outer(along, along)
    middle = np.asarray(base_mm, float) + along * height_mm / 2
    around = _around_axis(along, middle, height_mm / 2, base_radius_mm)
    return Shape(material, _ends(along, base_mm, 0.0, height_mm), _quadric(matrix, apex, 0.0), around)


def is_constant_along_z(shapes: Sequence[Shape]) -> bool:
    """Return whether all shapes are prisms along z that are infinite or end at the same heights."""
    ends = []
    for shape in shapes:
        curved = shape.quadric is not None and shape.quadric[2].any()
        along = np.abs(shape.planes[:, 2])
        if curved or not np.isin(along, (0.0, 1.0)).all():
            return False
        ends.append(sorted(map(tuple, shape.planes[along == 1][:, 2:])))
    ends = [limits for limits in ends if limits]
    return all(limits == ends[0] for limits in ends)


class ShapesScene(Scene):
    """A scene of geometric shapes.

    Parameters
    ----------
    shapes : sequence of Shape
        Later ones replace earlier ones where both are.
    energy_kev : float, optional
        Energy of the monochromatic beam, keV.

    Raises
    ------
    InputError
        If no shape has a material.
    """

    def __init__(self, shapes: Sequence[Shape], energy_kev: float = DISC_ENERGY_KEV, threads: int = 1):
        self.materials = tuple(dict.fromkeys(shape.material for shape in shapes if shape.material != NOTHING))
        if not self.materials:
            raise InputError(f"shapes: no shape has a material; give at least one a material other than '{NOTHING}'")
        self.energy_kev, self.threads, self.shapes = energy_kev, threads, tuple(shapes)
        index = {material: number for number, material in enumerate(self.materials)} | {NOTHING: -1}
        no_quadric = np.zeros((4, 4))
        self._shapes = Shapes(
            planes=np.concatenate([shape.planes for shape in shapes]),
            first_plane=np.cumsum([0, *(len(shape.planes) for shape in shapes)]),
            quadrics=np.stack([_packed(no_quadric if shape.quadric is None else shape.quadric) for shape in shapes]),
            curved=np.array([shape.quadric is not None for shape in shapes]),
            material=np.array([index[shape.material] for shape in shapes]),
            around=np.array([shape.around for shape in shapes], float),
        )

    def grown(self, by_mm: Sequence[float]) -> ShapesScene:
        """Return the scene with every shape grown, as Shape.grown."""
        shapes = [shape.grown(by) if by else shape for shape, by in zip(self.shapes, by_mm, strict=True)]
        return ShapesScene(shapes, self.energy_kev, self.threads)

    @property
    def radius_mm(self) -> float:
        """Largest distance from the z axis, mm."""
        x, y, radius = self._shapes.around.T[:3]
        return float((np.hypot(x, y) + radius).max())

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As GridScene.path_lengths, in any orbit."""
        geometry, shift = turned_back(geometry, pose, motion_mm)
        # Scale the rays instead of the object; lengths are scaled back by the kernel.
        sources = np.ascontiguousarray((geometry.source_mm - shift) / pose.size)
        to, rises = geometry.bundles()
        rays, rises = np.ascontiguousarray(np.moveaxis(to, 0, -1)) / pose.size, rises / pose.size
        lengths = np.zeros((len(self.materials), len(sources), len(rises), rays.shape[1]), np.float32)

        def run(first, last):
            part = sources[first:last], rays[first:last], rises, float(pose.size), lengths[:, first:last]
            chords(self._shapes, *part, Workspace.of(self._shapes))

        run_in_threads(run, len(sources), self.threads)
        return lengths.reshape(len(lengths), *geometry.shape)

    def edge_scans(
        self, geometry: ScanGeometry, samples: int, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None
    ) -> Iterator[EdgeScan]:
        """Yield the rays of all pixels that see an edge, as edges.edge_scans. The object does not move in them."""
        return edge_scans(self._shapes, geometry, samples, pose, motion_mm)


class DiscScene(ShapesScene):
    """A homogeneous cylinder along the z axis that is longer than the beam is high.

    Parameters
    ----------
    diameter_mm : float
        Diameter at size 1.
    mu_per_mm : float, optional
        Attenuation of the monochromatic beam in the material, 1/mm, from which its energy follows.
    energy_kev : float, optional
        Energy of the monochromatic beam, keV, without `mu_per_mm`.

    Raises
    ------
    InputError
        If the diameter is not positive, or the material has this attenuation at no energy.
    """

    def __init__(
        self, diameter_mm: float, material: str, mu_per_mm: float | None = None, energy_kev: float = DISC_ENERGY_KEV
    ):
        energy_kev = energy_kev if mu_per_mm is None else energy_of(material, mu_per_mm)
        super().__init__([cylinder(material, (0.0, 0.0, 0.0), diameter_mm / 2)], energy_kev)
        self._radius_mm = diameter_mm / 2

    @property
    def radius_mm(self) -> float:
        """Radius, mm."""
        return self._radius_mm

    def seen_pose(self, pose: Pose) -> Pose:
        """Return the part of a pose that changes path lengths: rotations and displacements along z have no effect."""
        return replace(pose, z_mm=0.0, turn_deg=0.0)


def _quadric(matrix: np.ndarray, centre_mm: Sequence[float], constant: float) -> np.ndarray:
    """Return the (4, 4) matrix of (x - c) . matrix (x - c) + constant in homogeneous coordinates (x, y, z, 1)."""
    center = np.asarray(centre_mm, float)
    quadric = np.empty((4, 4))
    quadric[:3, :3] = matrix
    quadric[:3, 3] = quadric[3, :3] = -matrix @ center
    quadric[3, 3] = center @ matrix @ center + constant
    return quadric


def _packed(quadric: np.ndarray) -> np.ndarray:
    """Return the 10 numbers of a quadric as in Shapes.quadrics."""
    return np.array(
        [*np.diag(quadric)[:3], quadric[0, 1], quadric[0, 2], quadric[1, 2], *quadric[:3, 3], quadric[3, 3]]
    )


def _ends(along: np.ndarray, point_mm: Sequence[float], low_mm: float, high_mm: float) -> np.ndarray:
    """Return two planes perpendicular to an axis, at the given distances from a point along it."""
    offset = float(along @ np.asarray(point_mm, float))
    return np.array([[*along, offset + high_mm], [*-along, -(offset + low_mm)]])


def _around(centre_mm: Sequence[float], radius_mm: float, half_height_mm: float) -> tuple[float, ...]:
    """Return Shape.around."""
    x, y, z = map(float, centre_mm)
    half = half_height_mm + MARGIN_MM
    return x, y, float(radius_mm) + MARGIN_MM, z - half, z + half


def _around_axis(along: np.ndarray, middle_mm: Sequence[float], half_mm: float, radius_mm: float) -> tuple[float, ...]:
    """Return Shape.around of a cylinder of any direction."""
    horizontal, vertical = float(np.hypot(*along[:2])), abs(float(along[2]))
    # Infinite length times 0 must be 0.
    reach, height = (half_mm * part if part > 0 else 0.0 for part in (horizontal, vertical))
    return _around(middle_mm, reach + radius_mm, height + radius_mm * horizontal)


def _unit(direction: Sequence[float], where: str) -> np.ndarray:
    direction = np.asarray(direction, float)
    length = np.linalg.norm(direction)
    if not length > 0:
        raise InputError(f"{where}: the direction {direction.tolist()} has no length; give a nonzero vector")
    return direction / length


def _positive(values: Sequence[float], where: str, key: str) -> None:
    if not all(value > 0 for value in values):
        raise InputError(f"{where}: {key} must be positive, not {', '.join(f'{value:g}' for value in values)}")
