"""A piece of the object that differs from what was stated: the one whose projections explain most of what a fit leaves.

An insert that is missing, a bubble or something that lies in the object is alike in all views but for where they see
it. Hardening, scatter and glare change the whole object, so that a piece is small beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal
from scipy.optimize import minimize

from ...base.errors import InputError
from ...base.geometry import Grid, ScanGeometry
from ...physics.beam.materials import attenuation_per_mm
from ...physics.scenes.sampling import averaged, divided
from ...physics.scenes.scene import IN_PLACE, Pose
from ...physics.scenes.shapes import Shape, ShapesScene, cylinder, ellipsoid
from ...projectors.cpu import CpuProjector

ACROSS = 64  # voxels of the grid on which a piece is looked for, over the object's width
RADII = (1.0, 2.0, 4.0, 8.0)  # that are tried there, in voxels: up to a quarter of the object's width
# Radius over the object's reach: what is larger is no piece of it, and could stand for what hardening and scatter do.
LARGEST = 0.25
ATTENUATES = 0.02  # of the largest line integral: less is noise or scatter beside the object
MOST_RAYS, FEWEST_VIEWS = 100_000, 24  # of the views by which place and radius are found
STEPS = 120  # of the simplex that finds place and radius
NEAR = 0.1  # of its radius: how far a piece is moved at first that was found already
FEWEST_VOXELS = 0.5  # radius of the smallest piece: rays of a scan pass by smaller ones
# Sum of squares of a ray's lengths over the sum of lengths, for radius 1: of a ball, and of a rod seen from its side.
OF_BALL, OF_ROD = 1.5, 16 / (3 * np.pi)


@dataclass(frozen=True)
class Piece:
    """A ball, or a rod along z through all slices.

    Attributes
    ----------
    place_mm : tuple of 3 float
        Of its middle in the object, x, y and z.
    more_per_mm : float
        By how much it attenuates more than was stated, 1/mm.
    """

    place_mm: tuple[float, float, float]
    radius_mm: float
    rod: bool
    more_per_mm: float = 0.0

    @property
    def shape(self) -> Shape:
        """It as a shape, of any material."""
        if self.rod:
            return cylinder("water", self.place_mm, self.radius_mm)
        return ellipsoid("water", self.place_mm, [self.radius_mm] * 3)

    def lengths_mm(
        self,
        geometry: ScanGeometry,
        pose: Pose = IN_PLACE,
        samples: int = 1,
        motion_mm: np.ndarray | None = None,
    ) -> np.ndarray:
        """Path lengths in it, the mean of so many rays per pixel and direction, shape (views, rows, columns)."""
        scene, total = ShapesScene([self.shape]), np.zeros(geometry.shape)
        for beside, weights in divided(geometry, samples):
            total += averaged(scene.path_lengths(beside, pose, motion_mm)[0].astype(np.float64), weights)
        return total

    def more_hu(self, energy_kev: float) -> float:
        """By how much it attenuates more than was stated, HU."""
        return 1000 * self.more_per_mm / float(attenuation_per_mm("water", [energy_kev])[0])

    def content(self, energy_kev: float) -> dict:
        """What diagnosis.json holds of it."""
        x, y, z = self.place_mm
        place = {"x_mm": x, "y_mm": y, "z_mm": None if self.rod else z}
        return place | {"width_mm": 2 * self.radius_mm, "hu": self.more_hu(energy_kev)}

    def words(self, energy_kev: float) -> str:
        """What it is, after "what is left".

        Parameters
        ----------
        energy_kev : float
            At which HU are counted, keV.
        """
        x, y, z = self.place_mm
        where = f"x {x:.0f}, y {y:.0f}" + ("" if self.rod else f", z {z:.0f}") + " mm"
        what = "a rod along z" if self.rod else "a piece"
        hu = self.more_hu(energy_kev)
        return (
            f"is like {what} of the object, {2 * self.radius_mm:.2g} mm wide at {where}, that has {abs(hu):.0f} HU "
            f"{'more' if hu > 0 else 'less'} than stated"
        )


def reach_of(lines: np.ndarray, geometry: ScanGeometry) -> float:
    """How far what attenuates reaches from the axis, as far as rays meet it.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
        Line integrals.

    Returns
    -------
    float
        At the isocentre, mm.
    """
    across = np.abs(geometry.column_positions_mm()) / geometry.magnification
    largest = lines.max(axis=(0, 1))
    return float(across[largest > ATTENUATES * largest.max()].max(initial=across.min()))


@dataclass(frozen=True)
class Left:
    """What a fit leaves of a scan, in which pieces are looked for.

    Attributes
    ----------
    residual, weight : ndarray, shape (views, rows, columns)
        Of line integrals, and their inverse variances.
    reach_mm : float
        How far the object reaches from its axis, mm.
    pose : Pose
        Of the object.
    samples : int
        Rays per pixel and direction.
    seen_from : ScanGeometry or None
        Where source and detector are by the fit; None: as stated.
    motion_mm : ndarray, shape (views, 3), or None
        Displacement of the object by the fit.
    """

    residual: np.ndarray
    weight: np.ndarray
    geometry: ScanGeometry
    reach_mm: float
    pose: Pose = IN_PLACE
    samples: int = 1
    seen_from: ScanGeometry | None = None
    motion_mm: np.ndarray | None = None

    def lengths_mm(self, one: Piece) -> np.ndarray:
        """Path lengths in a piece, shape (views, rows, columns)."""
        return one.lengths_mm(self.seen_from or self.geometry, self.pose, self.samples, self.motion_mm)

    @property
    def least_mm(self) -> float:
        """Radius of the smallest piece."""
        return FEWEST_VOXELS * 2 * self.reach_mm / ACROSS

    @property
    def fewer(self) -> Left:
        """The same of some views: hundreds of trials on all of a large scan would take minutes."""
        # Of views halved every second one has no weight.
        views = np.flatnonzero(self.weight.any(axis=(1, 2)))
        rays = self.residual.size * self.samples**2
        views = views[:: max(1, min(rays // MOST_RAYS, len(views) // FEWEST_VIEWS))]
        return replace(
            self,
            residual=self.residual[views],
            weight=self.weight[views],
            geometry=self.geometry.at(views),
            seen_from=None if self.seen_from is None else self.seen_from.at(views),
            motion_mm=None if self.motion_mm is None else self.motion_mm[views],
        )


def found(left: Left) -> Piece | None:
    """The ball or rod whose projections explain most of a residual.

    Returns
    -------
    Piece or None
        None where rays do not lie in the order that a back-projection needs, and where nothing is to be explained.
    """
    some = replace(left, samples=1).fewer  # many rays per pixel matter for the last millimetre alone
    begun = [_moved(start, some, start.radius_mm / 2, 0.3) for start in _looked_for(left)]
    if not begun:
        return None
    return refined(max(begun, key=lambda one: _explained(one, left)[0]), left)


def refined(start: Piece, left: Left) -> Piece | None:
    """The piece near one that explains most of a residual.

    Returns
    -------
    Piece or None
        None where nothing is explained.
    """
    one = _moved(start, left.fewer, NEAR * start.radius_mm, NEAR)
    explained, more = _explained(one, left)
    return replace(one, more_per_mm=more) if explained > 0 else None


def _moved(start: Piece, left: Left, by_mm: float, widened: float) -> Piece:
    """Where it explains most, by a simplex that begins with so large steps of place and of the radius's logarithm."""
    free = [0, 1] if start.rod else [0, 1, 2]

    def piece(numbers: Sequence[float]) -> Piece:
        place = np.array(start.place_mm)
        place[free] = numbers[:-1]
        radius = float(np.clip(np.exp(numbers[-1]), left.least_mm, LARGEST * left.reach_mm))
        return Piece((float(place[0]), float(place[1]), float(place[2])), radius, start.rod)

    first = np.array([*np.array(start.place_mm)[free], np.log(start.radius_mm)])
    spread = [by_mm] * len(free) + [widened]
    simplex = np.vstack([first, *(first + np.eye(len(first))[k] * spread[k] for k in range(len(first)))])
    result = minimize(
        lambda numbers: -_explained(piece(numbers), left)[0],
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": STEPS, "xatol": by_mm / 50, "fatol": 0.1},
    )
    return piece(result.x)


def _explained(one: Piece, left: Left) -> tuple[float, float]:
    """Chi-square that a piece explains, and by how much it attenuates more then, 1/mm."""
    lengths = left.lengths_mm(one)
    along, square = float((left.weight * left.residual * lengths).sum()), float((left.weight * lengths**2).sum())
    return (along**2 / square, along / square) if square > 0 else (0.0, 0.0)


def _looked_for(left: Left) -> list[Piece]:
    """The best ball and the best rod on a coarse grid, by back-projection.

    A ball's projections are the sums of those of its voxels. So its matched filter is the sum over the ball of the
    back-projected residual, and the square of its projections about that of the weights times its width.

    Returns
    -------
    list of Piece
        Without amounts; none where rays cannot be back-projected.
    """
    geometry, reach_mm = left.geometry, left.reach_mm
    spacing = 2 * reach_mm / ACROSS
    high = geometry.rows * geometry.row_pitch_mm / geometry.magnification
    slices = max(1, round(min(high, 2 * reach_mm) / spacing))
    middle = float(geometry.source_mm[:, 2].mean())
    grid = Grid((slices, ACROSS, ACROSS), (spacing, spacing, spacing))
    try:
        projector = CpuProjector(geometry, grid, lanes=2, centre_mm=(0.0, 0.0, middle))
    except InputError:  # a detector that is turned, or an object that the source does not go round
        return []
    both = np.stack([left.weight * left.residual, left.weight])
    packed = projector.pack_projections(both.astype(np.float32))
    back = projector.unpack_volume(projector.adjoint(packed)).astype(np.float64)
    z, y, x = grid.axes_mm()
    found = {}
    for radius in RADII:
        half = np.arange(-int(radius), int(radius) + 1)
        square = half[:, None, None] ** 2 + half[:, None] ** 2 + half**2
        ball = (square <= radius**2).astype(float)
        disc = (half[:, None] ** 2 + half**2 <= radius**2).astype(float)
        along, weighed = (signal.fftconvolve(one, ball, mode="same") for one in back)
        flat, flat_weighed = (signal.fftconvolve(one.sum(axis=0), disc, mode="same") for one in back)
        width = radius * spacing
        for rod, one, of, shape in ((False, along, weighed, OF_BALL), (True, flat, flat_weighed, OF_ROD)):
            seen = of > 1e-3 * of.max()
            gain = np.where(seen, one**2 / np.where(seen, shape * width * of, 1.0), 0.0)
            at = np.unravel_index(int(np.argmax(gain)), gain.shape)
            if gain[at] > found.get(rod, (0.0,))[0]:
                row, column = at[-2:]
                height = 0.0 if rod else float(z[at[0]]) + middle
                found[rod] = float(gain[at]), Piece((float(x[column]), float(y[row]), height), width, rod)
    return [piece for _, piece in found.values()]
