"""Poisson counts by the inverse of their distribution: one uniform number per pixel makes one count.

A count is the smallest n with P(N <= n) >= u. So it moves by one where mean or u pass a jump of the distribution and
nowhere else: means that differ in their last digit, as on another processor, leave nearly all counts as they are, and
the same uniform numbers give two scans the same noise. Drawing by rejection, as NumPy does, has neither property.

With w the normal deviate of u, P(N < x) = u, continued to real x by the incomplete gamma function, has the solution
x = mean + w sqrt(mean) + p1(w) + p2(w) / sqrt(mean) + ... (Cornish and Fisher's expansion, used for this by [1]_). The
count is the whole part of x. Where x is nearer to a whole number than the expansion may be off, the distribution itself
decides; small means are summed up term by term.

References
----------
.. [1] M. B. Giles, Algorithm 955, ACM Trans. Math. Softw. 42, 7, 2016.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammainc, gammaincc, ndtri

from ...base.compiled import compiled

PIXELS_AT_ONCE = 1 << 14  # whose arrays stay in a core's cache
SMALL_MEAN = 10.0  # below it terms are summed up, at most some thirty
# Sums of terms are off by some 1e-16: too much for the upper tail, where the distribution itself decides.
SUMMED_UP_TO = 1 - 1e-6
LARGEST_MEAN = 2.0**53  # whole numbers in double precision
# From here on the expansion is off by no more than double precision itself, and SciPy's incomplete gamma functions, in
# the tails beyond 4.5 standard deviations, by more.
LARGE_MEAN = 1e5
# What the expansion leaves out, from the sixth term on, and rounding are less than (NEAR + FAR w^8) / mean^2.5 +
# ROUNDED mean: twice the largest error found at whole x, where the incomplete gamma function gives w.
NEAR, FAR, ROUNDED = 0.08, 4e-4, 2e-15


def poisson_counts(mean: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """One draw of counts.

    Parameters
    ----------
    mean : ndarray
        From 0 to 2^53.
    random : numpy.random.Generator
        One uniform number per mean is taken, in the order of the array, and nothing else.

    Returns
    -------
    ndarray of int64
        Shaped as `mean`.

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
    """The smallest counts n with P(N <= n) >= u; 0 for u = 0.

    Exact but for u so near to a jump that double precision does not tell: within 1e-13 of the smaller of u and 1 - u at
    means up to 1e5, within 1e-11 up to 1e9.

    Parameters
    ----------
    uniform : ndarray, shape (pixels,)
        u in [0, 1).
    mean : ndarray, shape (pixels,)
        Of the Poisson distribution, from 0 to 2^53.

    Returns
    -------
    ndarray of int64, shape (pixels,)

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
    """Write counts, and the places of those that the distribution itself must decide; their number."""
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
    """The quantiles, from guesses on, by the incomplete gamma function."""
    counts = counts.copy()
    late = np.flatnonzero(~_reached(uniform, mean, counts))
    while late.size:
        counts[late] += 1
        late = late[~_reached(uniform[late], mean[late], counts[late])]
    early = np.flatnonzero(counts > 0)
    while early.size:
        early = early[_reached(uniform[early], mean[early], counts[early] - 1)]
        counts[early] -= 1
        early = early[counts[early] > 0]
    return counts


def _reached(uniform, mean, counts):
    """Whether P(N <= n) >= u, from that end of the distribution which is the nearer."""
    low = uniform < 0.5
    at, upper = counts + 1.0, 1 - uniform
    return np.where(low, gammaincc(at, mean) >= uniform, gammainc(at, mean) <= upper)
