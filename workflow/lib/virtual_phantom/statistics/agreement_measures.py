"""Standard measures of agreement: ICC, concordance correlation, coefficients of variation and of quartile dispersion.

Arrays have the shape (..., n subjects, k conditions, r repeats); leading axes (features) are kept. Subjects are ROIs,
conditions are groups of protocols, and repeats are seeds. All measures describe single scans: repeats improve the
estimates but are not averaged first. With one repeat, the ICCs equal the definitions of Shrout and Fleiss.

References
----------
ICC and its intervals: Shrout and Fleiss, Psychol. Bull. 86, 420, 1979; McGraw and Wong, Psychol. Methods 1, 30, 1996.
Concordance correlation: Lin, Biometrics 45, 255, 1989.
Coefficient of quartile variation: Bonett, Comput. Stat. Data Anal. 50, 2953, 2006.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

CONFIDENCE = 0.95  # level of the intervals
ROUNDING = 1e-12  # a sum of squares below this share of the sum of squared values is rounding error


@dataclass(frozen=True)
class Estimate:
    """Values of a measure with their 95 % intervals, shape (features,); NaN if not defined."""

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


def mean_squares(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean squares of a two-way analysis of variance, averaged over repeats.

    Each repeat gives one n x k table. The average has the expectation of a single table and a smaller variance.

    Returns
    -------
    msr, msc, mse : ndarray, shape (...)
        Between subjects, between conditions, and residual.
    """
    n, k = x.shape[-3:-1]
    subject, condition = x.mean(axis=-2, keepdims=True), x.mean(axis=-3, keepdims=True)
    grand = x.mean(axis=(-3, -2), keepdims=True)

    def mean_square(deviation, weight, freedom):
        squares = weight * (deviation**2).sum(axis=(-3, -2))
        size = (x**2).sum(axis=(-3, -2))
        return np.where(squares > ROUNDING * size, squares / freedom, 0.0).mean(axis=-1)

    return (
        mean_square(subject - grand, k, n - 1),
        mean_square(condition - grand, n, k - 1),
        mean_square(x - subject - condition + grand, 1, (n - 1) * (k - 1)),
    )


def icc_agreement_value(x: np.ndarray) -> np.ndarray:
    """Value of `icc_agreement`, without its interval."""
    n, k = x.shape[-3:-1]
    msr, msc, mse = mean_squares(x)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (msr - mse) / (msr + (k - 1) * mse + k * (msc - mse) / n)


def icc_agreement(x: np.ndarray) -> Estimate:
    """ICC(2,1) of Shrout and Fleiss, ICC(A,1) of McGraw and Wong: random subjects and conditions, absolute agreement.

    (MSR - MSE) / (MSR + (k - 1) MSE + k (MSC - MSE) / n). The interval is from McGraw and Wong, Table 7. It uses
    the degrees of freedom of one table, because more repeats of the same subjects tell little about other subjects.
    """
    n, k = x.shape[-3:-1]
    msr, msc, mse = mean_squares(x)
    value = icc_agreement_value(x)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = k * value / (n * (1 - value)), 1 + k * value * (n - 1) / (n * (1 - value))
        freedom = (a * msc + b * mse) ** 2 / ((a * msc) ** 2 / (k - 1) + (b * mse) ** 2 / ((n - 1) * (k - 1)))
        above = scipy.stats.f.ppf((1 + CONFIDENCE) / 2, n - 1, freedom)
        below = scipy.stats.f.ppf((1 + CONFIDENCE) / 2, freedom, n - 1)
        rest = k * msc + (k * n - k - n) * mse
        low = n * (msr - above * mse) / (above * rest + n * msr)
        high = n * (below * msr - mse) / (rest + n * below * msr)
    return _perfect_agreement(value, low, high)


def icc_consistency(x: np.ndarray) -> Estimate:
    """ICC(3,1) of Shrout and Fleiss, ICC(C,1) of McGraw and Wong: fixed conditions, whose mean shifts do not count.

    (MSR - MSE) / (MSR + (k - 1) MSE). The interval is the exact F interval of McGraw and Wong, Table 7.
    """
    n, k = x.shape[-3:-1]
    msr, _, mse = mean_squares(x)
    freedom = (n - 1, (n - 1) * (k - 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        value = (msr - mse) / (msr + (k - 1) * mse)
        ratio = msr / mse
        below = ratio / scipy.stats.f.ppf((1 + CONFIDENCE) / 2, *freedom)
        above = ratio * scipy.stats.f.ppf((1 + CONFIDENCE) / 2, *freedom[::-1])
        low, high = (below - 1) / (below + k - 1), (above - 1) / (above + k - 1)
    return _perfect_agreement(value, low, high)


def _perfect_agreement(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> Estimate:
    """Set both limits to 1 where agreement is perfect, because the residual in their denominators is zero there."""
    perfect = value == 1
    return Estimate(value, np.where(perfect, 1.0, low), np.where(perfect, 1.0, high))


def concordance(x: np.ndarray) -> np.ndarray:
    """Lin's concordance correlation coefficient, averaged over the k (k - 1) / 2 pairs of conditions.

    2 s_ab / (s_a^2 + s_b^2 + (m_a - m_b)^2) with moments over all subjects and repeats (divisor n r, as in Lin).
    Values are paired by subject and repeat. NaN where a pair of conditions does not vary.
    """
    k = x.shape[-2]
    values = np.moveaxis(x, -2, 0).reshape(k, *x.shape[:-3], -1)
    means = values.mean(axis=-1)
    deviations = values - means[..., None]
    # Deviations of equal values are rounding errors.
    deviations[(deviations**2).sum(axis=-1) <= ROUNDING * (values**2).sum(axis=-1)] = 0
    variances = (deviations**2).mean(axis=-1)
    pairs = []
    for a, b in combinations(range(k), 2):
        with np.errstate(divide="ignore", invalid="ignore"):
            covariance = (deviations[a] * deviations[b]).mean(axis=-1)
            pairs.append(2 * covariance / (variances[a] + variances[b] + (means[a] - means[b]) ** 2))
    return np.mean(pairs, axis=0)


def coefficient_of_variation(x: np.ndarray) -> np.ndarray:
    """Within-subject coefficient of variation [1]_.

    SD / |mean| of a subject's k r scans, root mean square over subjects. NaN where values of a subject differ in sign.

    References
    ----------
    .. [1] Raunig et al., Stat. Methods Med. Res. 24, 27, 2015.
    """
    scans = _scans_of_subjects(x)
    with np.errstate(divide="ignore", invalid="ignore"):
        subjects = scans.std(axis=-1, ddof=1) / np.abs(scans.mean(axis=-1))
    return np.where(_one_sign(scans), np.sqrt((subjects**2).mean(axis=-1)), np.nan)


def quartile_dispersion(x: np.ndarray) -> np.ndarray:
    """Quartile coefficient of dispersion, median over subjects.

    (Q3 - Q1) / |Q3 + Q1| of a subject's k r scans (quartiles interpolated linearly). NaN where values of a subject
    differ in sign.
    """
    scans = _scans_of_subjects(x)
    first, third = np.percentile(scans, [25, 75], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        subjects = (third - first) / np.abs(third + first)
    return np.where(_one_sign(scans), np.median(subjects, axis=-1), np.nan)


def _scans_of_subjects(x: np.ndarray) -> np.ndarray:
    """Join conditions and repeats: shape (..., subjects, k r)."""
    return x.reshape(*x.shape[:-2], -1)


def _one_sign(scans: np.ndarray) -> np.ndarray:
    """Return whether all values of each subject have one sign; otherwise a relative spread has no meaning."""
    return ((scans > 0).all(axis=-1) | (scans < 0).all(axis=-1)).all(axis=-1)
