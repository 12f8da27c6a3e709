"""Displacements at a velocity that changes uniformly during the scan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..base.vectors import ScanGeometry
from .effect import PER_SCAN, PER_SCAN_SQUARED, Parameter, Reach

PATH = "v t_i + a (t_i^2 - T^2 / 12) / 2, t_i = (i + 1/2 - N/2) dt from the middle of the scan, T = N dt"
FASTEST_CHANGE = 1e4  # mm/s^2
TO_THE_ENDS = 8  # a (T / 2)^2 / 2 is the displacement from the middle of the scan to its ends


def parameters(
    directions: Mapping[str, str], fastest: float, farthest_mm: float, typical_mm: float
) -> tuple[Parameter, ...]:
    """Return velocity and acceleration along each direction. Only the first velocity has a typical value other than 0.

    Parameters
    ----------
    directions : mapping of str to str
        {name: description}.
    fastest : float
        Largest plausible velocity, mm/s.
    farthest_mm, typical_mm : float
        Largest plausible and typical displacement in a scan, mm.
    """
    found, first = [], next(iter(directions))
    for name, along in directions.items():
        in_scan = typical_mm if name == first else 0.0
        reach = Reach(PER_SCAN, -farthest_mm, farthest_mm, 0.0, in_scan)
        found.append(
            Parameter(f"{name}_mm_per_s", "mm/s", f"velocity {along}", -fastest, fastest, 0.0, in_scan, reach=reach)
        )
    for name, along in directions.items():
        farthest = TO_THE_ENDS * farthest_mm
        reach, limit = Reach(PER_SCAN_SQUARED, -farthest, farthest, 0.0, 0.0), FASTEST_CHANGE
        key, title = f"{name}_mm_per_s2", f"{name} acceleration"
        found.append(
            Parameter(key, "mm/s2", f"acceleration {along}", -limit, limit, 0.0, 0.0, reach=reach, title=title)
        )
    return tuple(found)


def moved_mm(geometry: ScanGeometry, values: Mapping[str, float], directions: Mapping[str, str]) -> np.ndarray:
    """Return the displacement of every view along the directions, mm, shape (views, directions).

    Its mean over the scan is 0.
    """
    time, duration = geometry.times_s[:, None], geometry.duration_s
    velocity, acceleration = ([values[f"{name}_mm_per_{unit}"] for name in directions] for unit in ("s", "s2"))
    return time * velocity + (time**2 - duration**2 / 12) / 2 * acceleration
