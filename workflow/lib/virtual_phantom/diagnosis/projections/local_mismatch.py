"""Local object mismatch: the ball or rod whose projections explain most of the residual of a fit.

A missing insert or a bubble projects consistently into all views. A *piece* (ball or rod) is limited to a small part of
the object, because beam hardening, scatter and glare change the whole object.
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
from ...physics.scenes.sampling import average_rays, supersampled
from ...physics.scenes.scene import IN_PLACE, Pose
from ...physics.scenes.shapes import Shape, ShapesScene, cylinder, ellipsoid
from ...projectors.cpu import CpuProjector

ACROSS = 64  # voxels across the object in the grid of the first search
RADII = (1.0, 2.0, 4.0, 8.0)  # voxels, tried in the first search, up to a quarter of the object's width
# Largest radius over the object's radius. A larger piece could describe hardening and scatter.
LARGEST = 0.25
LEAST_ATTENUATION = 0.02  # of rays through the object, over the largest line integral; less is noise or scatter
MOST_RAYS, FEWEST_VIEWS = 100_000, 24  # used to fit position and radius
STEPS = 120  # of the simplex method for position and radius
NEAR = 0.1  # first step when a piece is refined, relative to its radius
FEWEST_VOXELS = 0.5  # radius of the smallest piece, in voxels of the first search, as rays miss smaller ones
# Sum of squared path lengths over the sum of path lengths for radius 1: ball, and rod seen from the side.
BALL_RATIO, ROD_RATIO = 1.5, 16 / (3 * np.pi)


@dataclass(frozen=True)
class Piece:
    """A ball, or a rod along z through all slices.

    Attributes
    ----------
    place_mm : tuple of 3 float
        Center in the object, x, y and z.
    more_per_mm : float
        Attenuation beyond the stated one, 1/mm.
    """

    place_mm: tuple[float, float, float]
    radius_mm: float
    rod: bool
    more_per_mm: float = 0.0

    @property
    def shape(self) -> Shape:
        """The piece as a shape; its material has no meaning."""
        if self.rod:
            return cylinder("water", self.place_mm, self.radius_mm)
        return ellipsoid("water", self.place_mm, [self.radius_mm] * 3)

    def lengths_mm(
        self, geometry: ScanGeometry, pose: Pose = IN_PLACE, samples: int = 1, motion_mm: np.ndarray | None = None
    ) -> np.ndarray:
        """Return path lengths in the piece, mean over the rays of each pixel, shape (views, rows, columns)."""
        scene, total = ShapesScene([self.shape]), np.zeros(geometry.shape)
        for sampled, weights in supersampled(geometry, samples):
            total += average_rays(scene.path_lengths(sampled, pose, motion_mm)[0].astype(np.float64), weights)
        return total

    def more_hu(self, energy_kev: float) -> float:
        """Return the attenuation beyond the stated one, HU."""
        return 1000 * self.more_per_mm / float(attenuation_per_mm("water", [energy_kev])[0])

    def content(self, energy_kev: float) -> dict:
        """Return the entry of the piece in diagnosis.json."""
        x, y, z = self.place_mm
        place = {"x_mm": x, "y_mm": y, "z_mm": None if self.rod else z}
        return place | {"width_mm": 2 * self.radius_mm, "hu": self.more_hu(energy_kev)}

    def words(self, energy_kev: float) -> str:
        """Return the piece in words, as a verb phrase."""
        x, y, z = self.place_mm
        where = f"x {x:.0f}, y {y:.0f}" + ("" if self.rod else f", z {z:.0f}") + " mm"
        what = "a rod along z" if self.rod else "a ball"
        hu = self.more_hu(energy_kev)
        return (
            f"is like {what} in the object, {2 * self.radius_mm:.2g} mm wide at {where}, that has {abs(hu):.0f} HU "
            f"{'more' if hu > 0 else 'less'} than stated"
        )


def object_radius_mm(lines: np.ndarray, geometry: ScanGeometry) -> float:
    """Return the radius of the attenuating object about the axis, mm; at most the half-width of the detector."""
    across = np.abs(geometry.column_positions_mm()) / geometry.magnification
    largest = lines.max(axis=(0, 1))
    return float(across[largest > LEAST_ATTENUATION * largest.max()].max(initial=across.min()))


@dataclass(frozen=True)
class FitResidual:
    """Residual of a fit, in which pieces are searched.

    Attributes
    ----------
    residual, weight : ndarray, shape (views, rows, columns)
        Residual line integrals, and their inverse variances.
    reach_mm : float
        Radius of the object, mm.
    samples : int
        Rays per pixel and direction.
    seen_from : ScanGeometry or None
        Fitted geometry; None: as stated.
    motion_mm : ndarray, shape (views, 3), or None
        Fitted displacement of the object.
    """

    residual: np.ndarray
    weight: np.ndarray
    geometry: ScanGeometry
    reach_mm: float
    pose: Pose = IN_PLACE
    samples: int = 1
    seen_from: ScanGeometry | None = None
    motion_mm: np.ndarray | None = None

    def lengths_mm(self, piece: Piece) -> np.ndarray:
        """Return path lengths in a piece, shape (views, rows, columns)."""
        return piece.lengths_mm(self.seen_from or self.geometry, self.pose, self.samples, self.motion_mm)

    @property
    def least_mm(self) -> float:
        """Radius of the smallest piece."""
        return FEWEST_VOXELS * 2 * self.reach_mm / ACROSS

    @property
    def view_subset(self) -> FitResidual:
        """A subset of the views: hundreds of trials with all views of a large scan would take minutes."""
        # If every second view is held out, the held-out views have no weight.
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


def best_piece(left: FitResidual) -> Piece | None:
    """Return the ball or rod whose projections explain most of a residual.

    The result is None for geometries without back-projection, and if no piece explains anything.
    """
    some = replace(left, samples=1).view_subset  # several rays per pixel matter for the last millimeter only
    begun = [_optimized(start, some, start.radius_mm / 2, 0.3) for start in _coarse_search(left)]
    if not begun:
        return None
    return refined_piece(max(begun, key=lambda piece: _explained(piece, left)[0]), left)


def refined_piece(start: Piece, left: FitResidual) -> Piece | None:
    """Return the piece near a given one that explains most of a residual; None if nothing is explained."""
    piece = _optimized(start, left.view_subset, NEAR * start.radius_mm, NEAR)
    explained, more = _explained(piece, left)
    return replace(piece, more_per_mm=more) if explained > 0 else None


def _optimized(start: Piece, left: FitResidual, step_mm: float, step_log_radius: float) -> Piece:
    """Optimize position and radius of a piece by the simplex method.

    The first steps are `step_mm` for the position and `step_log_radius` for the logarithm of the radius.
    """
    free = [0, 1] if start.rod else [0, 1, 2]

    def piece(numbers: Sequence[float]) -> Piece:
        place = np.array(start.place_mm)
        place[free] = numbers[:-1]
        radius = float(np.clip(np.exp(numbers[-1]), left.least_mm, LARGEST * left.reach_mm))
        return Piece((float(place[0]), float(place[1]), float(place[2])), radius, start.rod)

    first = np.array([*np.array(start.place_mm)[free], np.log(start.radius_mm)])
    spread = [step_mm] * len(free) + [step_log_radius]
    simplex = np.vstack([first, *(first + np.eye(len(first))[k] * spread[k] for k in range(len(first)))])
    result = minimize(
        lambda numbers: -_explained(piece(numbers), left)[0],
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": STEPS, "xatol": step_mm / 50, "fatol": 0.1},
    )
    return piece(result.x)


def _explained(piece: Piece, left: FitResidual) -> tuple[float, float]:
    """Return the chi-square that a piece explains, and its best attenuation, 1/mm."""
    lengths = left.lengths_mm(piece)
    along, square = float((left.weight * left.residual * lengths).sum()), float((left.weight * lengths**2).sum())
    return (along**2 / square, along / square) if square > 0 else (0.0, 0.0)


def _coarse_search(left: FitResidual) -> list[Piece]:
    """Return the best ball and the best rod on a coarse grid, by back-projection; empty if that is impossible.

    Projections of a ball are sums of projections of its voxels. Its matched filter is therefore the sum of the
    back-projected residual over the ball. The squared norm of its projections is approximately the sum of the
    back-projected weights times its width.
    """
    geometry, reach_mm = left.geometry, left.reach_mm
    spacing = 2 * reach_mm / ACROSS
    high = geometry.rows * geometry.row_pitch_mm / geometry.magnification
    slices = max(1, round(min(high, 2 * reach_mm) / spacing))
    middle = float(geometry.source_mm[:, 2].mean())
    grid = Grid((slices, ACROSS, ACROSS), (spacing, spacing, spacing))
    try:
        projector = CpuProjector(geometry, grid, lanes=2, centre_mm=(0.0, 0.0, middle))
    except InputError:  # a tilted detector, or a source that does not go around the object
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
        along, weighed = (signal.fftconvolve(volume, ball, mode="same") for volume in back)
        flat, flat_weighed = (signal.fftconvolve(volume.sum(axis=0), disc, mode="same") for volume in back)
        width = radius * spacing
        for rod, product, norm, shape in ((False, along, weighed, BALL_RATIO), (True, flat, flat_weighed, ROD_RATIO)):
            seen = norm > 1e-3 * norm.max()
            gain = np.where(seen, product**2 / np.where(seen, shape * width * norm, 1.0), 0.0)
            at = np.unravel_index(int(np.argmax(gain)), gain.shape)
            if gain[at] > found.get(rod, (0.0,))[0]:
                row, column = at[-2:]
                height = 0.0 if rod else float(z[at[0]]) + middle
                found[rod] = float(gain[at]), Piece((float(x[column]), float(y[row]), height), width, rod)
    return [piece for _, piece in found.values()]
