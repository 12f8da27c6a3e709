"""How unlike a recording is to a simulation of a description of it, whatever physics was left out.

Physics bends and shifts line integrals: hardening, scatter, a dark signal, glare. What it does depends mostly on the
line integral itself, so that a cubic polynomial of the simulated one takes it up, while a wrong angle, distance, axis
or object leaves other rays where there should be none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ...base.geometry import OrbitGeometry
from ...physics.scenes.scene import Pose
from ...recordings.scan import scan_geometry
from ..fitting.nuisance import LOCATION, PLACE, POSES
from .descriptions import STATED, Description

ORDER = 3  # of the polynomial
STEPS = 6  # of Gauss and Newton, at most
SETTLED = 1e-3  # relative change of the sum of squares that ends them
# What is fitted of a geometry that effects of the library may change: pixels, size of the object, mm over the scan.
GEOMETRY = ("columns_px", "rows_px", "size", "drift_x_mm", "drift_y_mm", "drift_z_mm")
# Differences that slopes are taken from.
STEP = {"x_mm": 0.5, "y_mm": 0.5, "z_mm": 0.5, "turn_deg": 0.25, "columns_px": 0.25, "rows_px": 0.25, "size": 0.002}
STEP |= {"drift_x_mm": 0.5, "drift_y_mm": 0.5, "drift_z_mm": 0.5}
START = {"size": 1.0}  # of the others 0
# How far off a geometry may be that effects of the library mend; more is another object or another description.
REACH = {"columns_px": 6.0, "rows_px": 6.0, "size": 0.08, "drift_x_mm": 20.0, "drift_y_mm": 20.0, "drift_z_mm": 20.0}
MOST_ATTENUATED = 6.0  # line integral beyond which rays weigh no less: noise of a few photons is no longer exp(-l)
QUARTER_DEG, ROUNDED_DEG = 90.0, 1.0  # start angles that are off by nearly quarter turns are off by just these
HALVINGS = 4  # of a step that makes it worse
CENTROID_UNSEEN = 1e-3  # of the largest slope of centroids: below is what rounding and truncation leave
UNSEEN = 1e-6  # of the largest slope: of what the object does not show
SCALED = 0.3  # logarithm of line integrals' scale that hardening, scatter and glare reach
SAMPLES = 2  # rays of a pixel along its columns and rows
NUDGE_MM = 5.0  # by which the object is moved to see how the centroids of views follow
CENTROIDS = 4  # steps by which they are matched: a fan beam magnifies what is nearer to the source
GRID, FINER = 7, 4  # locations along x and y of a search over the field of view, and times that it is refined
HOPELESS = 4.0  # times as much left as of the best so far after a first step: no further step makes up for that


@dataclass(frozen=True)
class Rays:
    """Pixels that are compared.

    Attributes
    ----------
    geometry : OrbitGeometry
        With these alone.
    row_step, column_step : int
        One of so many of the detector's.
    """

    geometry: OrbitGeometry
    row_step: int
    column_step: int


@dataclass(frozen=True)
class SetupMismatch:
    """How unlike a recording is to one description.

    Attributes
    ----------
    place : dict of str to float
        Of the object, by name of PLACE, and what of GEOMETRY was fitted, where it fits best.
    squares, noise, total : float
        Weighted sums of squares: what is left beside the polynomial, what of it is noise (0: not known), and of the
        line integrals themselves about their mean.
    scale : float
        Recorded over simulated line integrals.
    rays : int
        That were compared.
    turned : bool
        Whether the start angle was looked for.
    """

    description: Description
    place: dict[str, float]
    squares: float
    noise: float
    total: float
    scale: float
    rays: int
    turned: bool = False

    @property
    def name(self) -> str:
        """Of the mistake that is undone."""
        more = [*(["start angle"] if self.turned else []), *(["detector offset"] if self.shifted else [])]
        return ", ".join([*([self.description.name] if self.description.name != STATED or not more else []), *more])

    @property
    def shifted(self) -> bool:
        """Whether the detector's columns are off by more than effects of the library mend."""
        return abs(self.place.get("columns_px", 0.0)) > REACH["columns_px"]

    @property
    def line(self) -> str:
        """What to change in recording.yaml or in the data."""
        lines = [self.description.line]
        if self.turned:
            lines.append(self._start_angle())
        if self.shifted:
            offset = self.description.scan.get("column_offset_px", 0.0) + self.place["columns_px"]
            lines.append(f"scan.column_offset_px: {offset:.4g}")
        return "; ".join(filter(None, lines))

    def _start_angle(self) -> str:
        # An object turned by t and seen at angle b is the object seen at b - t.
        change = -self.place["turn_deg"]
        quarters = QUARTER_DEG * round(change / QUARTER_DEG)
        change = quarters if abs(change - quarters) < ROUNDED_DEG else change
        angle = (self.description.scan["start_angle_deg"] + change + 180) % 360 - 180
        return f"scan.start_angle_deg: {angle:.4g}"

    @property
    def share(self) -> float:
        """Of the variance of the line integrals, what is left of it beyond noise."""
        return max(self.squares - self.noise, 0.0) / self.total if self.total > 0 else 1.0

    def worse_than(self, other: SetupMismatch) -> float:
        """By how much its log likelihood falls behind, for normal errors whose size is not known."""
        return self.rays / 2 * float(np.log(max(self.squares, 1e-300) / max(other.squares, 1e-300)))


class Comparison:
    """A recording and what was scanned, for any description.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods.
    lines : ndarray, shape (repeats, views, rows, columns)
        Line integrals.
    usable : ndarray of bool, shape (views, rows, columns)
        Rays that count.
    most : sequence of 3 int
        Views, rows and columns that are compared at most.
    reach : mapping of str to float
        How far the object may lie off its place, by name of PLACE (mm, degrees), and line integrals off their scale
        ("scale"). What is not in it may be anything.
    location : mapping of str to float, optional
        Of the object as stated, by name of LOCATION, mm; 0 where it is not stated.
    """

    def __init__(
        self,
        scene,
        lines: np.ndarray,
        usable: np.ndarray,
        most: Sequence[int],
        reach: Mapping[str, float],
        location: Mapping[str, float] | None = None,
    ):
        self._scene, self._lines, self._usable, self._most, self._reach = scene, lines, usable, tuple(most), reach
        self._mu, self.location = scene.attenuation_per_mm, dict(location or {})
        self._anywhere, self._by_grid, self._kept = False, False, {}

    def coarser(self, most: Sequence[int]) -> Comparison:
        """The same of fewer rays."""
        found = copy(self)
        found._most, found._kept = tuple(most), {}
        return found

    def anywhere(self, by_grid: bool = False) -> Comparison:
        """The same with the object anywhere in the field of view.

        Parameters
        ----------
        by_grid : bool, optional
            Search a grid of locations; False: match the centroids of the views' line integrals, which is exact for a
            parallel beam that sees the whole object (first-moment condition of Helgason and Ludwig).
        """
        found = copy(self)
        found._anywhere, found._by_grid, found._kept = True, by_grid, {}
        return found

    def beyond_reach(self, found: SetupMismatch) -> bool:
        """Whether the object was found farther off its stated location than the alignment allows."""
        return any(
            abs(found.place[name] - self.location.get(name, 0.0)) > self._reach.get(name, np.inf) for name in LOCATION
        )

    def attenuated(self, description: Description) -> float:
        """Sum of the recorded line integrals over that of the simulated ones, of the rays that count."""
        mean, _, weight = self.data(description)
        simulated = self._simulated(self.rays(description), self.location)
        return float(mean[weight > 0].sum() / max(simulated[weight > 0].sum(), 1e-300))

    def begun(self, description: Description, turn_deg: float = 0.0) -> dict[str, float]:
        """Where a fit begins: the stated location, or, where the object may lie anywhere, the one found first."""
        start = {**self.location, "turn_deg": turn_deg}
        if not self._anywhere:
            return start
        key = description.name, turn_deg
        if key not in self._kept:
            if not turn_deg:
                self._kept[key] = (
                    self._on_grid(description, start) if self._by_grid else self._centred(description, start)
                )
            else:  # the location of an object that is not turned serves as a start
                other = self.begun(description) | {"turn_deg": turn_deg}
                self._kept[key] = other if self._by_grid else self._centred(description, other, steps=1)
        return self._kept[key]

    def _centred(
        self, description: Description, start: Mapping[str, float], steps: int = CENTROIDS
    ) -> dict[str, float]:
        """The location at which the centroids of the simulated views are those of the recorded ones.

        A shift of the detector's columns is fitted too, and kept where it is larger than effects of the library
        mend.
        """
        rays = self.rays(description)
        mean, _, weight = self.data(description)
        there = weight > 0
        wanted = _centroids(mean, there)

        def centroids(place: Mapping[str, float]) -> np.ndarray:
            return _centroids(self._simulated(rays, {**place, "columns_px": 0.0}), there)

        place, shift = dict(start), start.get("columns_px", 0.0)
        here, key = centroids(place), ("slopes", description.name)
        if key not in self._kept:
            nudged = [{**place, name: place.get(name, 0.0) + NUDGE_MM} for name in LOCATION]
            # Columns that lie farther along see the object earlier.
            of_columns = np.repeat([-1 / rays.column_step, 0.0], wanted.size // 2)
            self._kept[key] = np.stack([*((centroids(one) - here) / NUDGE_MM for one in nudged), of_columns])
        slopes = self._kept[key]
        for _ in range(steps):
            off = wanted - here - shift * slopes[-1]
            seen = np.isfinite(off) & np.isfinite(slopes).all(axis=0)
            if not seen.any():
                return dict(start)
            sizes = np.sqrt((slopes[:, seen] ** 2).sum(axis=1))
            known = sizes > CENTROID_UNSEEN * sizes.max()  # a cylinder shows no z
            change = np.zeros(len(slopes))
            change[known] = np.linalg.lstsq(slopes[known][:, seen].T, off[seen], rcond=1e-6)[0]
            place |= {name: place.get(name, 0.0) + by for name, by in zip(LOCATION, change, strict=False)}
            shift += change[-1]
            here = centroids(place)
        radius = self._field_radius_mm(rays)
        if not np.isfinite([place[name] for name in LOCATION]).all() or np.hypot(place["x_mm"], place["y_mm"]) > radius:
            return dict(start)
        place.pop("columns_px", None)
        return place | ({"columns_px": shift} if abs(shift) > REACH["columns_px"] else {})

    def _on_grid(self, description: Description, start: Mapping[str, float]) -> dict[str, float]:
        """The location on a grid over the field of view, refined about the best, that leaves least."""
        rays = self.rays(description)
        mean, _, weight = self.data(description)
        radius, best = self._field_radius_mm(rays), self._centred(description, start)

        def left(place: Mapping[str, float]) -> float:
            return self._left(rays, mean, weight, place).squares

        least, pitch = left(best), 2 * radius / GRID
        offsets = pitch * (np.arange(GRID) - (GRID - 1) / 2)
        middle = (0.0, 0.0)
        for _ in range(1 + FINER):
            for x, y in product(offsets, offsets):
                place = {**start, "z_mm": best.get("z_mm", 0.0), "x_mm": middle[0] + x, "y_mm": middle[1] + y}
                if np.hypot(place["x_mm"], place["y_mm"]) < radius and (squares := left(place)) < least:
                    best, least = place, squares
            middle, pitch = (best.get("x_mm", 0.0), best.get("y_mm", 0.0)), pitch / 2
            offsets = pitch * np.array([-1.0, 0.0, 1.0])
        return best

    @staticmethod
    def _field_radius_mm(rays: Rays) -> float:
        """Radius of the circle at the isocenter that the detector sees where it is not shifted."""
        geometry = rays.geometry
        return geometry.columns * geometry.column_pitch_mm / 2 / geometry.magnification

    def scaled_right(self, found: SetupMismatch) -> bool:
        """Whether the scale of line integrals is one that physics and what is known of it allow."""
        return abs(np.log(max(found.scale, 1e-9))) < max(SCALED, self._reach.get("scale", 0.0))

    def rays(self, description: Description) -> Rays:
        """Those that are compared.

        Raises
        ------
        InputError
            For lengths that cannot be.
        """
        whole = scan_geometry(dict(description.scan), "scan")
        views, rows, columns = self._steps((whole.views, whole.rows, whole.columns))
        thinned = {}
        for axis, step in (("row", rows), ("column", columns)):
            length, offset = getattr(whole, f"{axis}s"), getattr(whole, f"{axis}_offset_px")
            count = len(range(_first(length, step), length, step))
            thinned |= {
                f"{axis}s": count,
                f"{axis}_pitch_mm": getattr(whole, f"{axis}_pitch_mm") * step,
                f"{axis}_offset_px": (_first(length, step) - (length - 1) / 2 + offset) / step + (count - 1) / 2,
            }
        return Rays(replace(whole.every(views), **thinned), rows, columns)

    def data(self, description: Description) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean over repeats, variance of that mean (0: not known) and weight of the rays that are compared."""
        lines, usable = description.axes(self._lines), description.axes(self._usable)
        views, rows, columns = self._steps(usable.shape)
        chosen = (
            slice(None, None, views),
            slice(_first(usable.shape[1], rows), None, rows),
            slice(_first(usable.shape[2], columns), None, columns),
        )
        lines, usable = description.values(lines[:, *chosen].astype(np.float64)), usable[chosen]
        mean, n = lines.mean(axis=0), len(lines)
        variance = lines.var(axis=0, ddof=1) / n if n > 1 else np.zeros_like(mean)
        return mean, variance, np.where(usable, np.exp(-np.clip(mean, 0, MOST_ATTENUATED)), 0.0)

    def unlike(
        self,
        description: Description,
        turn_deg: float = 0.0,
        best: SetupMismatch | None = None,
        also: Sequence[str] = (),
    ) -> SetupMismatch:
        """Fit the object's place and say what is left.

        Parameters
        ----------
        turn_deg : float, optional
            From where the object's turn is looked for.
        best : SetupMismatch, optional
            Of another description: what is hopelessly worse is not fitted to its end.
        also : sequence of str, optional
            Of GEOMETRY, fitted too.

        Raises
        ------
        InputError
            For lengths that cannot be.
        """
        rays = self.rays(description)
        mean, variance, weight = self.data(description)
        root = np.sqrt(weight).ravel()
        begun = self.begun(description, turn_deg)
        names = tuple(dict.fromkeys((*PLACE, *also, *(name for name in begun if name not in PLACE))))
        start = np.array([{**START, **begun}.get(name, 0.0) for name in names])
        reach = {**REACH, **self._reach} | (dict.fromkeys(LOCATION, np.inf) if self._anywhere else {})
        reach = np.array([reach.get(name, np.inf) for name in names])
        place, found = start, self._left(rays, mean, weight, dict(zip(names, start, strict=True)))
        for _ in range(STEPS):
            slopes = []
            for axis, name in enumerate(names):
                moved = dict(zip(names, place + STEP[name] * np.eye(len(names))[axis], strict=True))
                slopes.append((self._simulated(rays, moved) - found.simulated).ravel() / STEP[name])
            down = found.slope.ravel() * np.array(slopes) * root
            sizes = np.sqrt((down**2).sum(axis=1))
            seen = sizes > UNSEEN * max(sizes.max(), 1e-30)  # a disc has no turn
            basis = np.vstack([down[seen] / sizes[seen, None], _powers(found.simulated) * root])
            solved = np.linalg.lstsq(basis.T, root * found.residual.ravel(), rcond=1e-6)[0][: seen.sum()]
            change = np.zeros(len(names))
            change[seen] = solved / sizes[seen]
            tried = np.clip(place + change, start - reach, start + reach)
            after = self._left(rays, mean, weight, dict(zip(names, tried, strict=True)))
            for _ in range(HALVINGS):
                if after.squares <= found.squares:
                    break
                tried = (place + tried) / 2
                after = self._left(rays, mean, weight, dict(zip(names, tried, strict=True)))
            if after.squares >= found.squares:
                break
            settled = found.squares - after.squares < SETTLED * found.squares
            place, found = tried, after
            if settled or (best is not None and found.squares * best.total > HOPELESS * best.squares * found.total):
                break
        return SetupMismatch(
            description,
            {name: float(value) for name, value in zip(names, place, strict=True)},
            found.squares,
            float((weight * variance).sum()),
            found.total,
            found.scale,
            int((weight > 0).sum()),
            turn_deg != 0,
        )

    def residual(self, found: SetupMismatch) -> np.ndarray:
        """What a description leaves of line integrals, as means over rows, shape (views, columns)."""
        rays = self.rays(found.description)
        mean, _, weight = self.data(found.description)
        left = self._left(rays, mean, weight, found.place).residual * weight
        whole = weight.sum(axis=1)
        return left.sum(axis=1) / np.where(whole > 0, whole, np.inf)

    def at_turns(self, description: Description, turns_deg: Sequence[float]) -> np.ndarray:
        """Share of the squares that is left with the object in its place, turned by each angle."""
        rays = self.rays(description)
        mean, _, weight = self.data(description)
        left = [self._left(rays, mean, weight, self.begun(description, float(turn))) for turn in turns_deg]
        return np.array([one.squares / one.total for one in left])

    def _steps(self, shape: Sequence[int]) -> tuple[int, ...]:
        return tuple(-(-length // most) for length, most in zip(shape, self._most, strict=True))

    def _simulated(self, rays: Rays, place: Mapping[str, float]) -> np.ndarray:
        """Line integrals of pixels, each the mean of the transmissions of its rays."""
        geometry, parts = rays.geometry, (1 / rays.row_step, 1 / rays.column_step)
        down, across = (part * (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / SAMPLES for part in parts)
        down = down if geometry.rows > 1 else np.zeros(1)
        pose = Pose(**{name: place[name] for name in POSES if name in place})
        drift = [place.get(f"drift_{axis}_mm", 0.0) for axis in "xyz"]
        motion = np.outer(geometry.view_times / geometry.views, drift) if any(drift) else None
        transmitted = 0.0
        for row, column in product(down, across):
            moved = replace(
                geometry,
                row_offset_px=geometry.row_offset_px + row + place.get("rows_px", 0.0) * parts[0],
                column_offset_px=geometry.column_offset_px + column + place.get("columns_px", 0.0) * parts[1],
            )
            paths = self._scene.path_lengths(moved, pose, motion)
            transmitted = transmitted + np.exp(-np.tensordot(self._mu, paths.astype(np.float64), 1))
        return -np.log(transmitted / (len(down) * len(across)))

    def _left(self, rays: Rays, mean: np.ndarray, weight: np.ndarray, place: Mapping[str, float]) -> _Left:
        simulated = self._simulated(rays, place)
        total = float((weight * (mean - np.average(mean, weights=weight)) ** 2).sum())
        apart = simulated - np.average(simulated, weights=weight)
        if not (weight * apart * mean).sum() > 0:  # falls where it should rise
            residual = mean - np.average(mean, weights=weight)
            return _Left(simulated, residual, np.zeros_like(mean), total, total, 0.0)
        root = np.sqrt(weight).ravel()
        powers = _powers(simulated)
        found = np.linalg.lstsq((powers * root).T, root * mean.ravel(), rcond=None)[0]
        residual = mean - (found @ powers).reshape(mean.shape)
        rising = sum(k * found[k] * powers[k - 1] for k in range(1, ORDER + 1)).reshape(mean.shape)
        squares = float((weight * residual**2).sum())
        scale = float((weight * simulated * mean).sum() / (weight * simulated**2).sum())
        return _Left(simulated, residual, rising, squares, total, scale)


@dataclass(frozen=True)
class _Left:
    """Simulated line integrals, what is left of the recorded ones beside their polynomial, and its slope."""

    simulated: np.ndarray
    residual: np.ndarray
    slope: np.ndarray
    squares: float
    total: float
    scale: float


def _centroids(lines: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Centroids of every view's line integrals along columns, then along rows.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)
    there : ndarray of bool, shape (views, rows, columns)
        Rays that count.

    Returns
    -------
    ndarray, shape (2 * views,)
        In pixels compared; NaN where a view attenuates nothing, and along rows where there is one.
    """
    values = np.where(there, lines, 0.0)
    mass = values.sum(axis=(1, 2))
    columns, rows = np.arange(lines.shape[2]), np.arange(lines.shape[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        across = (values.sum(axis=1) * columns).sum(axis=1) / mass
        down = (values.sum(axis=2) * rows).sum(axis=1) / mass
    alone = lines.shape[1] == 1
    return np.where(
        np.tile(mass, 2) > 0, np.concatenate([across, np.full_like(down, np.nan) if alone else down]), np.nan
    )


def _powers(simulated: np.ndarray) -> np.ndarray:
    return simulated.ravel() ** np.arange(ORDER + 1)[:, None]


def _first(length: int, step: int) -> int:
    """The first of every so many, so that those taken lie about the middle."""
    return (length - 1) % step // 2
