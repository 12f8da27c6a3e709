"""Objects known only by a simulated scan: path lengths of other rays are interpolated between its rays.

A ray is described by its direction in the plane and its distance from the axis. Exactly one source angle and fan angle
of a scan on a circle have both [1]_, and cubic splines interpolate between views, rows and columns. Out of the plane,
the row is that of the ray at the same height next to the axis; the path length is scaled for another inclination.

References
----------
.. [1] A. C. Kak and M. Slaney, Principles of Computerized Tomographic Imaging, IEEE Press, 1988, section 3.4.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import spline_filter1d

from ...base.compiled import compiled
from ...base.errors import InputError
from ...base.geometry import OrbitGeometry, ScanGeometry
from ...base.pose import IN_PLACE, Pose, turned_back
from ...projectors.lanes import OPTIONS
from ...projectors.threads import run_in_threads
from .scene import Scene

PAD = 3  # samples beyond an edge: two for cubic splines, and one for views that are rounded up to a full turn
OBJECT_MM = 1.0  # path length in water of the thinnest ray through the object
UNEVEN = 0.01  # difference of steps between views, of a step: smaller errors of interpolation than those of its splines
WIDEST_STEP_RAD = np.pi / 6  # far above the limit of sampling (Kak and Slaney, section 5.1); wider steps skip turns
ROUNDING = 1e-6  # of the number of views in a turn
FEWEST_COLUMNS = 4  # of a cubic spline


class SimulatedScene(Scene):
    """An object given by path lengths of one scan through each material.

    Parameters
    ----------
    paths_mm : ndarray, shape (materials, views, rows, columns)
        Path lengths of the rays to the centers of the pixels, mm.
    geometry : OrbitGeometry
    energy_kev, materials
        As in Scene.

    Raises
    ------
    InputError
        For a scan with a displaced or flying focal spot, or too few columns.
    """

    def __init__(
        self,
        paths_mm: np.ndarray,
        geometry: OrbitGeometry,
        energy_kev: float,
        threads: int = 1,
        materials: tuple[str, ...] = ("water",),
    ):
        if geometry.has_focal_spot_offset:
            raise InputError(
                "simulation: rays of a displaced or flying focal spot cannot be interpolated; give an object"
            )
        if geometry.columns < FEWEST_COLUMNS:
            raise InputError(
                f"simulation: {geometry.columns} columns cannot be interpolated; use at least {FEWEST_COLUMNS}"
            )
        self.paths_mm, self.geometry, self.energy_kev, self.threads = paths_mm, geometry, energy_kev, threads
        self.materials = materials
        angles, columns = geometry.angles_rad, np.arange(geometry.columns)
        steps = np.diff(angles)
        if len(steps) < 1 or np.abs(steps - steps[0]).max() > UNEVEN * abs(steps[0]) or abs(steps[0]) > WIDEST_STEP_RAD:
            raise InputError(
                "simulation: rays between uneven views, or views more than 30 degrees apart, cannot be interpolated; "
                "give an object"
            )
        self._step = (angles[-1] - angles[0]) / (geometry.views - 1)
        self._turn = 2 * np.pi / abs(self._step)
        self._closed = not geometry.feed_per_rotation_mm and abs(self._turn - geometry.views) < ROUNDING * self._turn
        across, nearer = geometry.on_surface_mm(geometry.column_positions_mm())
        ahead = geometry.source_to_detector_mm - nearer
        self._column = CubicSpline(np.arctan2(across, ahead), columns)
        self._length = CubicSpline(columns, np.hypot(across, ahead))
        self._coefficients = [_spline(paths, self._closed) for paths in paths_mm]
        through = (paths_mm > OBJECT_MM).any(axis=(0, 1, 2))
        off_axis = geometry.source_to_isocentre_mm * np.sin(np.arctan2(across, ahead))
        self.radius_mm = float(np.abs(off_axis[through]).max(initial=0.0))

    def path_lengths(self, geometry: ScanGeometry, pose: Pose = IN_PLACE, motion_mm: np.ndarray | None = None):
        """As GridScene.path_lengths."""
        own = self.geometry
        geometry, shift = turned_back(geometry, pose, motion_mm)
        x, y, z = ((geometry.source_mm - shift) / pose.size).T[..., None]
        (to_x, to_y, to_z), rises = geometry.bundles()
        length = np.hypot(to_x, to_y)
        climb = (to_z[:, None] + rises[:, None]) / length[:, None]
        # The ray of the simulated scan with this direction and this distance from the axis.
        fan = np.arcsin(np.clip((y * to_x - x * to_y) / length / own.source_to_isocentre_mm, -1, 1))
        view = self._views(np.arctan2(to_x, -to_y) - fan, z)
        column = np.clip(self._column(fan), 0, own.columns - 1)
        # Its row, by the height next to the axis.
        height = z[:, None] - climb * ((x * to_x + y * to_y) / length)[:, None]
        above = height - np.interp(view, np.arange(own.views), own.source_z_mm)[:, None]
        own_climb = above / (own.source_to_isocentre_mm * np.cos(fan))[:, None]
        row = (own_climb * self._length(column)[:, None] - own.row_positions_mm()[0]) / own.row_pitch_mm
        row = np.clip(row, 0, own.rows - 1)
        found = np.empty((len(self.materials), *row.shape), np.float32)

        def run(first: int, last: int) -> None:
            part = slice(first, last)
            for coefficients, paths in zip(self._coefficients, found, strict=True):
                _interpolate(coefficients, view[part], row[part], column[part], paths[part])

        run_in_threads(run, len(view), self.threads)
        found *= pose.size * np.sqrt((1 + climb**2) / (1 + own_climb**2))
        return found.reshape(-1, *geometry.shape)

    def _views(self, angle_rad: np.ndarray, z_mm: np.ndarray) -> np.ndarray:
        """Return the indices of source angles, in the turn of the given heights."""
        own, last = self.geometry, self.geometry.views - 1
        view = (angle_rad - own.angles_rad[0]) / self._step
        if self._closed:
            return view % own.views
        heights = own.source_z_mm
        near = (z_mm - heights[0]) / (heights[-1] - heights[0]) * last if own.feed_per_rotation_mm else last / 2
        return np.clip(view - self._turn * np.round((view - near) / self._turn), 0, last)


def _spline(values: np.ndarray, closed: bool) -> np.ndarray:
    """Return coefficients of cubic B-splines with PAD more samples on each side; views of a full turn are periodic."""
    found = values.astype(np.float64)
    for axis, periodic in enumerate((closed, False, False)):
        pad = [(PAD, PAD) if other == axis else (0, 0) for other in range(3)]
        if found.shape[axis] == 1:
            found = np.pad(found, pad, mode="edge")
            continue
        found = spline_filter1d(found, axis=axis, mode="grid-wrap" if periodic else "mirror")
        found = np.pad(found, pad, mode="wrap" if periodic else "reflect")
    return found.astype(np.float32)


@compiled(**OPTIONS)
def _weights(part):
    """Return the cubic B-splines of the four samples around a point, `part` behind the second."""
    rest = 1 - part
    return (
        rest * rest * rest / 6,
        (4 - 6 * part * part + 3 * part * part * part) / 6,
        (4 - 6 * rest * rest + 3 * rest * rest * rest) / 6,
        part * part * part / 6,
    )


@compiled(**OPTIONS)
def _interpolate(coefficients, views, rows, columns, found):
    """Write splines at indices views and columns (views, bundles) and rows (views, rows, bundles) into `found`."""
    for i in range(rows.shape[0]):
        for k in range(rows.shape[2]):
            view, column = int(views[i, k]), int(columns[i, k])
            of_views, of_columns = _weights(views[i, k] - view), _weights(columns[i, k] - column)
            for j in range(rows.shape[1]):
                row = int(rows[i, j, k])
                of_rows = _weights(rows[i, j, k] - row)
                total = 0.0
                for a in range(4):
                    for b in range(4):
                        line = 0.0
                        for c in range(4):
                            line += (
                                of_columns[c]
                                * coefficients[view + PAD - 1 + a, row + PAD - 1 + b, column + PAD - 1 + c]
                            )
                        total += of_views[a] * of_rows[b] * line
                found[i, j, k] = total
