"""Adjusted p-values for multiple tests."""

from __future__ import annotations

import numpy as np
import scipy


def bonferroni(p: np.ndarray | float, tests: int) -> np.ndarray:
    """Bonferroni-adjusted p-values, which control the family-wise error rate."""
    return np.minimum(1.0, np.asarray(p, float) * tests)


def holm(p: np.ndarray) -> np.ndarray:
    """Holm's step-down adjusted p-values (Scand. J. Stat. 6, 65, 1979), which control the family-wise error rate."""
    order = np.argsort(p, kind="stable")
    steps = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(steps, 1)
    return adjusted


def benjamini_yekutieli(p: np.ndarray) -> np.ndarray:
    """False discovery rates that are valid for any dependence of the tests (Ann. Stat. 29, 1165, 2001)."""
    return scipy.stats.false_discovery_control(p, method="by")
