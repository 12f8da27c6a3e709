"""Mismatch between a recording and a description of its scan, independent of missing physics.

Beam hardening, scatter, dark signal and glare change line integrals mostly as a function of the line integral itself. A
cubic polynomial of the simulated line integrals describes this, but not a wrong angle, distance, axis or object.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy import ndimage

from ...base.geometry import OrbitGeometry
from ...physics.scenes.sampling import SupersampledScan, average_rays
from ...physics.scenes.scene import Pose
from ...recordings.scan import scan_geometry
from ..fitting.nuisance import LOCATION, PLACE, POSES
from ..projections.observed import NOISE_OF_VIEWS
from .data_checks import variance_of_one_repeat
from .descriptions import STATED, Description

ORDER = 3  # of the polynomial
STEPS = 6  # most Gauss-Newton steps
SETTLED = 1e-3  # relative change of the sum of squares that ends the fit
# Parameters of the geometry that effects may change: pixels, size of the object, mm over the scan.
GEOMETRY = ("columns_px", "rows_px", "size", "drift_x_mm", "drift_y_mm", "drift_z_mm")
# Steps of finite differences.
STEP = {"x_mm": 0.5, "y_mm": 0.5, "z_mm": 0.5, "turn_deg": 0.25, "columns_px": 0.25, "rows_px": 0.25, "size": 0.002}
STEP |= {"drift_x_mm": 0.5, "drift_y_mm": 0.5, "drift_z_mm": 0.5}
START = {"size": 1.0}  # all others start at 0
# Largest errors of the geometry that effects can describe; larger ones mean another object or description.
REACH = {"columns_px": 6.0, "rows_px": 6.0, "size": 0.08, "drift_x_mm": 20.0, "drift_y_mm": 20.0, "drift_z_mm": 20.0}
MOST_ATTENUATED = 6.0  # line integral above which the weight exp(-l) stays constant, because of other noise
QUARTER_DEG, ROUNDED_DEG = 90.0, 1.0  # start angles close to quarter turns are rounded to these
HALVINGS = 4  # of a step that increases the sum of squares
CENTROID_UNSEEN = 1e-3  # of the largest slope of centroids; less is rounding and truncation
UNSEEN = 1e-6  # of the largest slope, for parameters that the object does not show
SCALED = 0.3  # logarithm of the scale of line integrals that hardening, scatter and glare reach
SAMPLES = 2  # rays per pixel and direction
NUDGE_MM = 5.0  # step of the object for the derivative of the centroids of views
DISPLACEMENTS = 2  # steps to match the centroids of views by displacements on the detector
CENTROIDS = 4  # steps to match the centroids, as the magnification of a fan beam depends on the location
GRID, FINER = 7, 4  # locations along x and y of a search over the field of view, and number of refinements
SIGNIFICANT = 3.0  # standard errors of the noise that a mismatch must exceed
HOPELESS = 4.0  # ratio to the best sum of squares so far from which a fit stops after its first step


@dataclass(frozen=True)
class Rays:
    """Pixels that are compared.

    Attributes
    ----------
    row_step, column_step : int
        Steps between the detector's rows and columns.
    mean, variance, weight : ndarray, shape (views, rows, columns)
        Mean line integral over repeats, its variance (0 if unknown), and weight.
    """

    geometry: OrbitGeometry
    row_step: int
    column_step: int
    mean: np.ndarray
    variance: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class SetupMismatch:
    """Mismatch between a recording and one description.

    Attributes
    ----------
    place : dict of str to float
        Fitted pose of the object, by name of PLACE, and fitted parameters of GEOMETRY.
    squares, noise, noise_error, total : float
        Weighted sums of squares: residual, its noise (0 if unknown) with its standard error, and line integrals about
        their mean.
    scale : float
        Ratio of recorded and simulated line integrals.
    """

    description: Description
    place: dict[str, float]
    squares: float
    noise: float
    noise_error: float
    total: float
    scale: float
    rays: int
    turned: bool = False

    @property
    def name(self) -> str:
        """Name of the mistake that the description corrects."""
        more = [*(["start angle"] if self.turned else []), *(["detector offset"] if self.shifted else [])]
        return ", ".join([*([self.description.name] if self.description.name != STATED or not more else []), *more])

    @property
    def shifted(self) -> bool:
        """Whether the column offset is larger than effects can describe."""
        return abs(self.place.get("columns_px", 0.0)) > REACH["columns_px"]

    @property
    def line(self) -> str:
        """Change of recording.yaml or of the data."""
        lines = [self.description.line]
        if self.turned:
            lines.append(self._start_angle())
        if self.shifted:
            offset = self.description.scan.get("column_offset_px", 0.0) + self.place["columns_px"]
            lines.append(f"scan.column_offset_px: {offset:.4g}")
        return "; ".join(filter(None, lines))

    def _start_angle(self) -> str:
        # A rotation of the object by t is equivalent to view angles that are smaller by t.
        change = -self.place["turn_deg"]
        quarters = QUARTER_DEG * round(change / QUARTER_DEG)
        change = quarters if abs(change - quarters) < ROUNDED_DEG else change
        angle = (self.description.scan["start_angle_deg"] + change + 180) % 360 - 180
        return f"scan.start_angle_deg: {angle:.4g}"

    @property
    def share(self) -> float:
        """Share of the variance of the line integrals that remains beyond noise."""
        return max(self.squares - self.noise, 0.0) / self.total if self.total > 0 else 1.0

    @property
    def is_visible(self) -> bool:
        """Whether line integrals vary significantly more than noise."""
        return self.total - self.noise > SIGNIFICANT * self.noise_error

    def exceeds(self, share: float) -> bool:
        """Return whether significantly more than a share of the variance beyond noise remains."""
        left = self.squares - self.noise - SIGNIFICANT * self.noise_error
        return left > share * max(self.total - self.noise, 0.0)

    def worse_than(self, other: SetupMismatch) -> float:
        """Return by how much another mismatch has a larger log likelihood, for normal errors of unknown variance."""
        return self.rays / 2 * float(np.log(max(self.squares, 1e-300) / max(other.squares, 1e-300)))


class Comparison:
    """Comparison of a recording with the scanned object, for any description of the scan.

    Parameters
    ----------
    most : sequence of 3 int
        Largest number of compared views, rows and columns.
    reach : mapping of str to float
        Tolerances of the pose, by name of PLACE (mm, degrees), and of the scale of line integrals ("scale"). Parameters
        without a tolerance are free.
    location : mapping of str to float, optional
        Stated location of the object, by name of LOCATION, mm; 0 if not stated.
    not_checked : collection of str, optional
        Checks of lengths to skip (recordings.scan.scan_geometry).
    """

    def __init__(
        self,
        scene,
        lines: np.ndarray,
        usable: np.ndarray,
        most: Sequence[int],
        reach: Mapping[str, float],
        location: Mapping[str, float] | None = None,
        not_checked: Collection[str] = (),
    ):
        self._scene, self._lines, self._usable, self._most, self._reach = scene, lines, usable, tuple(most), reach
        self._mu, self.location = scene.attenuation_per_mm, dict(location or {})
        self._anywhere, self._by_grid, self._cache, self._not_checked = False, False, {}, not_checked

    def coarser(self, most: Sequence[int]) -> Comparison:
        """Return the comparison with fewer rays."""
        found = copy(self)
        found._most, found._cache = tuple(most), {}
        return found

    def anywhere(self, by_grid: bool = False) -> Comparison:
        """Return the comparison with the object anywhere in the field of view.

        Parameters
        ----------
        by_grid : bool, optional
            Whether to search a grid of locations. Otherwise the centroids of the views are matched, which is exact for
            a parallel beam that covers the whole object (first-moment condition of Helgason and Ludwig).
        """
        found = copy(self)
        found._anywhere, found._by_grid, found._cache = True, by_grid, {}
        return found

    def beyond_reach(self, found: SetupMismatch) -> bool:
        """Return whether the object is farther from its stated location than the alignment allows."""
        return any(
            abs(found.place[name] - self.location.get(name, 0.0)) > self._reach.get(name, np.inf) for name in LOCATION
        )

    def attenuated(self, description: Description) -> float:
        """Return the ratio of the sums of recorded and simulated line integrals."""
        rays = self.rays(description)
        simulated, there = self._simulated(rays, self.location), rays.weight > 0
        return float(rays.mean[there].sum() / max(simulated[there].sum(), 1e-300))

    def begun(self, description: Description, turn_deg: float = 0.0) -> dict[str, float]:
        """Return the start of a fit: the stated location, or the result of the search over the field of view."""
        start = {**self.location, "turn_deg": turn_deg}
        if not self._anywhere:
            return start
        key = description.name, turn_deg
        if key not in self._cache:
            steps = CENTROIDS
            if turn_deg:  # start at the location of the object without rotation
                start, steps = self.begun(description) | {"turn_deg": turn_deg}, 1
            if not self._by_grid:
                start = self._centred(description, start, steps)
            self._cache[key] = self._on_grid(description, start) if self._by_grid and not turn_deg else start
        return self._cache[key]

    def _centred(
        self, description: Description, start: Mapping[str, float], steps: int = CENTROIDS
    ) -> dict[str, float]:
        """Return the location that matches the centroids of simulated and recorded views.

        A column offset is fitted too, and kept if it is larger than effects can describe.
        """
        rays = self.rays(description)
        there = rays.weight > 0
        wanted = _centroids(rays.mean, there)

        def centroids(place: Mapping[str, float]) -> np.ndarray:
            return _centroids(self._simulated(rays, {**place, "columns_px": 0.0}), there)

        place, shift = dict(start), start.get("columns_px", 0.0)
        here, key = centroids(place), ("slopes", description.name)
        if key not in self._cache:
            nudged = [{**place, name: place.get(name, 0.0) + NUDGE_MM} for name in LOCATION]
            # A positive column offset moves the centroid to smaller columns.
            of_columns = np.repeat([-1 / rays.column_step, 0.0], wanted.size // 2)
            self._cache[key] = np.stack([*((centroids(moved) - here) / NUDGE_MM for moved in nudged), of_columns])
        slopes = self._cache[key]
        for _ in range(steps):
            off = wanted - here - shift * slopes[-1]
            seen = np.isfinite(off) & np.isfinite(slopes).all(axis=0)
            if not seen.any():
                return dict(start)
            sizes = np.sqrt((slopes[:, seen] ** 2).sum(axis=1))
            known = sizes > CENTROID_UNSEEN * sizes.max()  # a cylinder does not determine z
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
        """Return the location with the smallest residual on a grid over the field of view, refined about the best."""
        rays = self.rays(description)
        radius, best = self._field_radius_mm(rays), self._centred(description, start)
        least, pitch = self._left(rays, best).squares, 2 * radius / GRID
        offsets = pitch * (np.arange(GRID) - (GRID - 1) / 2)
        middle = (0.0, 0.0)
        for _ in range(1 + FINER):
            for x, y in product(offsets, offsets):
                place = {**start, "z_mm": best.get("z_mm", 0.0), "x_mm": middle[0] + x, "y_mm": middle[1] + y}
                if np.hypot(place["x_mm"], place["y_mm"]) >= radius:
                    continue
                if (squares := self._left(rays, place).squares) < least:
                    best, least = place, squares
            middle, pitch = (best.get("x_mm", 0.0), best.get("y_mm", 0.0)), pitch / 2
            offsets = pitch * np.array([-1.0, 0.0, 1.0])
        return best

    @staticmethod
    def _field_radius_mm(rays: Rays) -> float:
        """Return the radius of the field of view of a centered detector, mm."""
        geometry = rays.geometry
        return geometry.columns * geometry.column_pitch_mm / 2 / geometry.magnification

    def scaled_right(self, found: SetupMismatch) -> bool:
        """Return whether physics and the tolerance allow the scale of the line integrals."""
        return abs(np.log(max(found.scale, 1e-9))) < max(SCALED, self._reach.get("scale", 0.0))

    def rays(self, description: Description) -> Rays:
        """Return the pixels that are compared.

        Raises
        ------
        InputError
            For impossible lengths.
        """
        whole = scan_geometry(dict(description.scan), "scan", self._not_checked)
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
        return Rays(replace(whole.every(views), **thinned), rows, columns, *self._data(description))

    def _data(self, description: Description) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return Rays.mean, variance and weight."""
        lines, usable = description.axes(self._lines), description.axes(self._usable)
        views, rows, columns = self._steps(usable.shape)
        chosen = (
            slice(None, None, views),
            slice(_first(usable.shape[1], rows), None, rows),
            slice(_first(usable.shape[2], columns), None, columns),
        )
        lines, usable = description.values(lines[:, *chosen].astype(np.float64)), usable[chosen]
        mean, n = lines.mean(axis=0), len(lines)
        if n > 1:
            variance = lines.var(axis=0, ddof=1) / n
        else:
            variance = self._variance_of_one(description, chosen[1])[chosen[0], :, chosen[2]]
        return mean, variance, np.where(usable, np.exp(-np.clip(mean, 0, MOST_ATTENUATED)), 0.0)

    def _variance_of_one(self, description: Description, rows: slice) -> np.ndarray:
        """Return the noise variance of a single repeat in all views and columns of some rows."""
        key = "variance", description.name
        if key not in self._cache:
            lines, usable = (description.axes(values) for values in (self._lines[0], self._usable))
            lines = description.values(lines[:, rows].astype(np.float64))
            self._cache[key] = variance_of_one_repeat(lines, usable[:, rows])
        return self._cache[key]

    def mismatch(
        self,
        description: Description,
        turn_deg: float = 0.0,
        best: SetupMismatch | None = None,
        also: Sequence[str] = (),
    ) -> SetupMismatch:
        """Fit the pose of the object and return the remaining mismatch.

        Parameters
        ----------
        turn_deg : float, optional
            Start of the object's rotation.
        best : SetupMismatch, optional
            Mismatch of another description. The fit stops early if it is far worse.
        also : sequence of str, optional
            Parameters of GEOMETRY to fit.

        Raises
        ------
        InputError
            For impossible lengths.
        """
        rays = self.rays(description)
        root = np.sqrt(rays.weight).ravel()
        begun = self.begun(description, turn_deg)
        names = tuple(dict.fromkeys((*PLACE, *also, *(name for name in begun if name not in PLACE))))
        start = np.array([{**START, **begun}.get(name, 0.0) for name in names])
        reach = {**REACH, **self._reach} | (dict.fromkeys(LOCATION, np.inf) if self._anywhere else {})
        reach = np.array([reach.get(name, np.inf) for name in names])
        place, found = start, self._left(rays, dict(zip(names, start, strict=True)))
        for _ in range(STEPS):
            slopes = []
            for axis, name in enumerate(names):
                moved = dict(zip(names, place + STEP[name] * np.eye(len(names))[axis], strict=True))
                slopes.append((self._simulated(rays, moved) - found.simulated).ravel() / STEP[name])
            down = found.slope.ravel() * np.array(slopes) * root
            sizes = np.sqrt((down**2).sum(axis=1))
            seen = sizes > UNSEEN * max(sizes.max(), 1e-30)  # a disc does not determine rotation
            basis = np.vstack([down[seen] / sizes[seen, None], _powers(found.simulated) * root])
            solved = np.linalg.lstsq(basis.T, root * found.residual.ravel(), rcond=1e-6)[0][: seen.sum()]
            change = np.zeros(len(names))
            change[seen] = solved / sizes[seen]
            tried = np.clip(place + change, start - reach, start + reach)
            after = self._left(rays, dict(zip(names, tried, strict=True)))
            for _ in range(HALVINGS):
                if after.squares <= found.squares:
                    break
                tried = (place + tried) / 2
                after = self._left(rays, dict(zip(names, tried, strict=True)))
            if after.squares >= found.squares:
                break
            settled = found.squares - after.squares < SETTLED * found.squares
            place, found = tried, after
            if settled or (best is not None and found.squares * best.total > HOPELESS * best.squares * found.total):
                break
        fitted = {name: float(value) for name, value in zip(names, place, strict=True)}
        of_rays, count = rays.weight * rays.variance, int((rays.weight > 0).sum())
        noise, n = float(of_rays.sum()), len(self._lines)
        # Errors of the sum of squares of the residual, and of the noise that is subtracted.
        error = np.hypot(
            np.sqrt(2 * (of_rays**2).sum() * (1 + 1 / max(n - 1, 1))), (NOISE_OF_VIEWS if n == 1 else 0.0) * noise
        )
        squares = found.squares, noise, float(error), found.total
        return SetupMismatch(description, fitted, *squares, found.scale, count, turn_deg != 0)

    def displaced(self, found: SetupMismatch) -> SetupMismatch:
        """Return the mismatch that remains if the object moved from view to view by up to REACH.

        Each simulated view is displaced on the detector to match the centroid of the recorded view.
        """
        rays = self.rays(found.description)
        there = rays.weight > 0
        simulated, wanted = self._simulated(rays, found.place), _centroids(rays.mean, there)
        steps = np.array([[rays.column_step], [rays.row_step]])
        most = np.array([[REACH["columns_px"]], [REACH["rows_px"]]]) / steps
        by, moved = np.zeros((2, len(simulated))), simulated
        for _ in range(DISPLACEMENTS):
            off = np.nan_to_num(wanted - _centroids(moved, there)).reshape(by.shape)
            by = np.clip(by + off, -most, most)
            views = zip(simulated, *by, strict=True)
            moved = np.stack(
                [ndimage.shift(view, (down, across), order=1, mode="nearest") for view, across, down in views]
            )
        left = self._fitted(rays, moved)
        return replace(found, squares=left.squares, total=left.total, scale=left.scale)

    def residual(self, found: SetupMismatch) -> np.ndarray:
        """Return residual line integrals of a description, as means over rows, shape (views, columns)."""
        rays = self.rays(found.description)
        left = self._left(rays, found.place).residual * rays.weight
        whole = rays.weight.sum(axis=1)
        return left.sum(axis=1) / np.where(whole > 0, whole, np.inf)

    def at_turns(self, description: Description, turns_deg: Sequence[float]) -> np.ndarray:
        """Return the remaining share of the squares for each rotation of the object, without a fit."""
        rays = self.rays(description)
        left = [self._left(rays, self.begun(description, float(turn))) for turn in turns_deg]
        return np.array([residual.squares / residual.total for residual in left])

    def _steps(self, shape: Sequence[int]) -> tuple[int, ...]:
        return tuple(-(-length // most) for length, most in zip(shape, self._most, strict=True))

    def _simulated(self, rays: Rays, place: Mapping[str, float]) -> np.ndarray:
        """Return line integrals of pixels, from the mean transmission of their rays."""
        geometry, parts = rays.geometry, (1 / rays.row_step, 1 / rays.column_step)
        down, across = (part * (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / SAMPLES for part in parts)
        down = down if geometry.rows > 1 else np.zeros(1)
        pose = Pose(**{name: place[name] for name in POSES if name in place})
        drift = [place.get(f"drift_{axis}_mm", 0.0) for axis in "xyz"]
        motion = np.outer(geometry.view_times / geometry.views, drift) if any(drift) else None
        moved = replace(
            geometry,
            row_offset_px=geometry.row_offset_px + place.get("rows_px", 0.0) * parts[0],
            column_offset_px=geometry.column_offset_px + place.get("columns_px", 0.0) * parts[1],
        )
        paths = self._scene.path_lengths(SupersampledScan(moved, tuple(across), tuple(down)), pose, motion)
        transmitted = np.exp(-np.tensordot(self._mu, paths.astype(np.float64), 1))
        return -np.log(average_rays(transmitted, np.full((len(down), len(across)), 1 / (len(down) * len(across)))))

    def _left(self, rays: Rays, place: Mapping[str, float]) -> _Left:
        return self._fitted(rays, self._simulated(rays, place))

    @staticmethod
    def _fitted(rays: Rays, simulated: np.ndarray) -> _Left:
        mean, weight = rays.mean, rays.weight
        total = float((weight * (mean - np.average(mean, weights=weight)) ** 2).sum())
        centered = simulated - np.average(simulated, weights=weight)
        if not (weight * centered * mean).sum() > 0:  # negative correlation
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
    """Simulated line integrals, residual of the polynomial fit, and slope of the polynomial."""

    simulated: np.ndarray
    residual: np.ndarray
    slope: np.ndarray
    squares: float
    total: float
    scale: float


def _centroids(lines: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return the centroids of every view's line integrals along columns, then along rows.

    Parameters
    ----------
    lines : ndarray, shape (views, rows, columns)

    Returns
    -------
    ndarray, shape (2 * views,)
        In compared pixels; NaN for views without attenuation, and along rows for a single row.
    """
    values = np.where(there, lines, 0.0)
    mass = values.sum(axis=(1, 2))
    columns, rows = np.arange(lines.shape[2]), np.arange(lines.shape[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        across = (values.sum(axis=1) * columns).sum(axis=1) / mass
        down = (values.sum(axis=2) * rows).sum(axis=1) / mass
    if lines.shape[1] == 1:
        down[:] = np.nan
    return np.where(np.tile(mass, 2) > 0, np.concatenate([across, down]), np.nan)


def _powers(simulated: np.ndarray) -> np.ndarray:
    return simulated.ravel() ** np.arange(ORDER + 1)[:, None]


def _first(length: int, step: int) -> int:
    """Return the first index such that indices at this step are centered."""
    return (length - 1) % step // 2
