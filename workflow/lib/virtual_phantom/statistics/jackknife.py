"""Standard error from estimates that each leave out one unit (Quenouille, Biometrika 43, 353, 1956; Tukey 1958)."""

from __future__ import annotations

import numpy as np


def standard_error(without_one: np.ndarray) -> np.ndarray:
    """Return the standard errors from estimates along the last axis, each without one repeat or region."""
    n = without_one.shape[-1]
    deviations = without_one - without_one.mean(axis=-1, keepdims=True)
    return np.sqrt((n - 1) / n * (deviations**2).sum(axis=-1))
