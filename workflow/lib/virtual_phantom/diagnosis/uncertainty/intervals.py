"""Intervals of a level where errors are noise's and, beside these, those of inexact models.

Most models are nearly exact and a few are far off, so that errors by models are no normal ones: most of them are much
smaller than the largest. By the share that a model may be off, its error is normal, and how far that share itself can
be trusted makes it Student's t [1]_.

References
----------
.. [1] Guide to the expression of uncertainty in measurement, JCGM 100:2008, E.4.3 and G.4.2.
"""

from __future__ import annotations

import numpy as np
from scipy import special, stats
from scipy.optimize import brentq

from ..fitting.steps import NORMAL_95, interval

# Of Student's t of errors by models: by [1], their size is off by about half of it. Settled on seeds 74 and 75 of
# benchmarks/intervals.py.
DEGREES = 2
NODES, LARGEST = 1000, 6.0  # of the integral over that size; closed forms are met to 1e-5


def half_width(level: float, noise: float, whole: float) -> float:
    """Half the width of an interval that the error of a number lies in with a given probability.

    The error is n + m: n is normal, m is Student's t of which 95 % lie where they would by a normal distribution of the
    standard error `(whole**2 - noise**2)**0.5`. An interval of 95 % is so as wide as that of a normal distribution of
    `whole`, to 3 %.

    Parameters
    ----------
    level : float
        From 0 to 1.
    noise : float
        Standard error by noise.
    whole : float
        With inexact models counted; not below `noise`.

    Returns
    -------
    float
        In the unit of the errors; infinite where they are.
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
    """Intervals of a fitted number, cut to what is plausible, as diagnoses tell them.

    Parameters
    ----------
    noise, whole : float
        Standard errors, as `half_width` takes them.
    low, high : float, optional
        The least and the largest value that the number may have.

    Returns
    -------
    dict
        {"ci50", "ci95": for noise and for inexact models, "ci95_noise": for noise alone}, each [low, high].
    """
    return {
        "ci50": interval(value, half_width(0.5, noise, whole) / NORMAL_95, low, high),
        "ci95": interval(value, whole, low, high),
        "ci95_noise": interval(value, noise, low, high),
    }
