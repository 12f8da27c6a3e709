"""Velocities that change uniformly during a scan."""

import numpy as np

from .effect import Parameter

SLOWING = Parameter("slowing", "1", "c: velocities fall from v (1 + c) to v (1 - c)", -1.0, 1.0, 0.0, 0.0, None)
POSITION = "v (t_i - c (t_i^2 - mean) / T), T: time from the first view to the last"


def constant_velocity_times(times_s: np.ndarray, slowing: float) -> np.ndarray:
    """Return the times, s, at which a constant velocity would lead to the same positions. Their mean is 0.

    Parameters
    ----------
    times_s : ndarray, shape (views,)
        Relative to the middle of the scan, s.
    """
    duration = np.ptp(times_s)
    return times_s - slowing * (times_s**2 - np.mean(times_s**2)) / duration if duration else times_s
