"""Confidence intervals with noise and model errors.

Most models are nearly exact and a few are far off, so that model errors have heavier tails than a normal distribution.
For a given relative error of a model they are normal; the uncertainty of that relative error makes them Student's t
[1]_.

References
----------
.. [1] Guide to the expression of uncertainty in measurement, JCGM 100:2008, E.4.3 and G.4.2.
"""

from __future__ import annotations

import numpy as np
from scipy import special, stats
from scipy.optimize import brentq

from ..fitting.steps import NORMAL_95, interval

# Degrees of freedom of model errors: by [1], their size is uncertain by about half of it. Chosen with seeds 74 and 75
# of benchmarks/intervals.py.
DEGREES = 2
NODES, LARGEST = 1000, 6.0  # of the integral over the size of model errors, which agrees with closed forms to 1e-5


def half_width(level: float, noise: float, whole: float) -> float:
    """Return half the width of the interval that contains the error of a parameter with a given probability.

    The error is n + m. Here n is normal, and m has Student's t distribution with the same 95 % quantile as a normal
    distribution with the standard error `(whole**2 - noise**2)**0.5`. The 95 % interval is as wide as for a normal
    distribution with the standard error `whole`, to 3 %.

    Parameters
    ----------
    noise, whole : float
        Standard errors by noise, and with model errors (at least `noise`).
    """
    if not whole or np.isinf(whole):
        return float(whole)
    noise = min(noise / whole, 1.0)
    scale = np.sqrt(1 - noise**2) * NORMAL_95 / stats.t.ppf(0.975, DEGREES)
    # Student's t is normal with a variance of scale^2 / x^2, where DEGREES x^2 is of a chi-square distribution.
    x = (np.arange(NODES) + 0.5) * (LARGEST / NODES)
    weights = 2 * DEGREES * x * stats.chi2.pdf(DEGREES * x**2, DEGREES) * (LARGEST / NODES)
    sd = np.hypot(noise, scale / x)

    def beyond(half: float) -> float:
        return float(weights @ special.erf(half / sd / np.sqrt(2))) - level

    return whole * brentq(beyond, 0.0, 100.0, xtol=1e-9)


def intervals(value: float, noise: float, whole: float, low: float = -np.inf, high: float = np.inf) -> dict:
    """Return confidence intervals of a fitted parameter, clipped to its plausible range.

    Parameters
    ----------
    noise, whole : float
        Standard errors, as in `half_width`.

    Returns
    -------
    dict
        Keys `ci50` and `ci95` (with model errors) and `ci95_noise` (noise alone), each with [low, high].
    """
    return {
        "ci50": interval(value, half_width(0.5, noise, whole) / NORMAL_95, low, high),
        "ci95": interval(value, whole, low, high),
        "ci95_noise": interval(value, noise, low, high),
    }
