"""p-values of many tests at once."""

from __future__ import annotations

import numpy as np
import scipy


def bonferroni(p: np.ndarray | float, tests: int) -> np.ndarray:
    """p-values of the smallest of so many: an error of 5 % in all of the tests together."""
    return np.minimum(1.0, np.asarray(p, float) * tests)


def holm(p: np.ndarray) -> np.ndarray:
    """Holm's step-down adjusted p-values (Scand. J. Stat. 6, 65, 1979): an error of 5 % in all tests together."""
    order = np.argsort(p, kind="stable")
    steps = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(steps, 1)
    return adjusted


def benjamini_yekutieli(p: np.ndarray) -> np.ndarray:
    """False discovery rates, valid however the tests depend on each other (Ann. Stat. 29, 1165, 2001)."""
    return scipy.stats.false_discovery_control(p, method="by")
