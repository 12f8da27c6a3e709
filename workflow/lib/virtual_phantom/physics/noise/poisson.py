"""Poisson counts by inversion of the distribution function: one uniform number per pixel gives one count.

A count is the smallest n with P(N <= n) >= u. It changes by one when mean or u pass a jump of the distribution, and is
constant elsewhere. Rounding errors of the mean, as on another processor, therefore leave nearly all counts unchanged,
and two scans with the same uniform numbers have the same noise. Rejection sampling, as in NumPy, has neither property.

Let w be the normal quantile of u. The equation P(N < x) = u, extended to real x by the incomplete gamma function, has
the solution x = mean + w sqrt(mean) + p1(w) + p2(w) / sqrt(mean) + ... (Cornish-Fisher expansion, as in [1]_). The
count is floor(x). If x is closer to a whole number than the error of the expansion, the distribution function itself is
evaluated. For small means the probabilities are summed.

References
----------
.. [1] M. B. Giles, Algorithm 955, ACM Trans. Math. Softw. 42, 7, 2016.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammainc, gammaincc, ndtri

from ...base.compiled import compiled

PIXELS_AT_ONCE = 1 << 14  # so that arrays fit into the cache
SMALL_MEAN = 10.0  # below this mean about thirty probabilities are summed
# The sum has an error of about 1e-16, too much for the upper tail, where the distribution function is evaluated.
SUMMED_UP_TO = 1 - 1e-6
LARGEST_MEAN = 2.0**53  # whole numbers in double precision
# Above this mean the expansion is exact to double precision, and more accurate than SciPy's incomplete gamma functions,
# which lose digits beyond 4.5 standard deviations.
LARGE_MEAN = 1e5
# Upper limit of the error of the expansion (terms from the sixth on, and rounding): (NEAR + FAR w^8) / mean^2.5 +
# ROUNDED mean. This is twice the largest error at whole x, where the incomplete gamma function gives w.
NEAR, FAR, ROUNDED = 0.08, 4e-4, 2e-15


def poisson_counts(mean: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return random counts, int64, for means from 0 to 2^53.

    Parameters
    ----------
    random : numpy.random.Generator
        Gives one uniform number per mean, in the order of the array.

    Raises
    ------
    ValueError
        As `quantiles`.
    """
    mean = np.ascontiguousarray(mean, dtype=np.float64)
    counts = np.empty(mean.shape, np.int64)
    means, drawn = mean.reshape(-1), counts.reshape(-1)
    for first in range(0, means.size, PIXELS_AT_ONCE):
        part = slice(first, first + PIXELS_AT_ONCE)
        drawn[part] = quantiles(random.random(means[part].size), means[part])
    return counts


def quantiles(uniform: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return the smallest counts n with P(N <= n) >= u, int64; 0 for u = 0.

    Results are exact unless u is so close to a jump that double precision cannot resolve it. This distance, relative to
    the smaller of u and 1 - u, is 1e-13 at means up to 1e5, and 1e-11 up to 1e9.

    Parameters
    ----------
    uniform : ndarray, shape (pixels,)
        u in [0, 1).
    mean : ndarray, shape (pixels,)
        From 0 to 2^53.

    Raises
    ------
    ValueError
        For numbers outside the bounds.
    """
    if not (uniform.size == 0 or (uniform.min() >= 0 and uniform.max() < 1)):
        raise ValueError("uniform numbers must be at least 0 and less than 1")
    if not (mean.size == 0 or (mean.min() >= 0 and mean.max() <= LARGEST_MEAN)):
        raise ValueError("means of Poisson counts must be from 0 to 2^53")
    counts, unsure = np.empty(mean.size, np.int64), np.empty(mean.size, np.int64)
    unsure = unsure[: _expand(uniform, ndtri(uniform), mean, counts, unsure)]
    if unsure.size:
        counts[unsure] = _search(uniform[unsure], mean[unsure], counts[unsure])
    return counts


@compiled(nogil=True, error_model="numpy")  # no fastmath: the same operations on every processor
def _expand(uniform, deviate, mean, counts, unsure):
    """Write counts, and the indices of uncertain ones; return the number of uncertain counts."""
    count = 0
    for i in range(mean.size):
        u, w, m = uniform[i], deviate[i], mean[i]
        if m < SMALL_MEAN:
            n, term = 0, math.exp(-m)
            total = term
            if u > SUMMED_UP_TO:
                unsure[count] = i
                count += 1
            else:
                while total < u:
                    n += 1
                    term *= m / n
                    total += term
            counts[i] = n
            continue
        if u == 0.0:
            counts[i] = 0
            continue
        root, w2 = math.sqrt(m), w * w
        over = 1.0 / root
        first = w2 / 6.0 + 1.0 / 3.0
        second = -w * (w2 / 72.0 + 1.0 / 36.0)
        third = w2 * (w2 / 270.0 + 7.0 / 810.0) - 8.0 / 405.0
        fourth = -w * (w2 * (w2 * (23.0 / 17280.0) + 137.0 / 38880.0) - 671.0 / 38880.0)
        fifth = w2 * (w2 * (w2 * (19.0 / 34020.0) + 5.0 / 3024.0) - 5189.0 / 408240.0) - 16.0 / 25515.0
        x = m + (root * w + (first + over * (second + over * (third + over * (fourth + over * fifth)))))
        if m < LARGE_MEAN:
            off = (NEAR + FAR * w2 * w2 * w2 * w2) * (over * over) ** 2 * over + ROUNDED * m
            if abs(x - np.rint(x)) <= off:
                unsure[count] = i
                count += 1
        counts[i] = int(max(math.floor(x), 0.0))
    return count


def _search(uniform: np.ndarray, mean: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the quantiles by evaluation of the distribution function, starting from approximate counts."""
    counts = counts.copy()
    low = np.flatnonzero(~_reached(uniform, mean, counts))
    while low.size:
        counts[low] += 1
        low = low[~_reached(uniform[low], mean[low], counts[low])]
    high = np.flatnonzero(counts > 0)
    while high.size:
        high = high[_reached(uniform[high], mean[high], counts[high] - 1)]
        counts[high] -= 1
        high = high[counts[high] > 0]
    return counts


def _reached(uniform, mean, counts):
    """Return whether P(N <= n) >= u, computed from the nearer tail to keep precision."""
    shape, upper = counts + 1.0, 1 - uniform
    return np.where(uniform < 0.5, gammaincc(shape, mean) >= uniform, gammainc(shape, mean) <= upper)
