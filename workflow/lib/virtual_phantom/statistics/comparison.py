"""Compare simulated with recorded features, in units of the recording's repeatability.

Features agree only if equivalence is shown: the confidence interval of the difference lies within a margin (two
one-sided tests [1]_). Features that are neither equivalent nor significantly different are undecided.

References
----------
.. [1] Schuirmann, J. Pharmacokinet. Biopharm. 15, 657, 1987.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from ..features.names import family, features_of
from ..features.tables import finite_values
from . import COMPARED_REPEATS
from .multiplicity import benjamini_yekutieli, holm

# One repeat SD: one of three single scans of the recording deviates from the mean by more.
MARGIN_SD = 1.0
# With ten repeats each, the 90 % interval of a ratio of SDs extends by a factor of 1.8 to either side, so equivalence
# within a narrower margin could hardly ever be shown.
SD_FACTOR = 2.0
LEVEL = 0.95  # of intervals
ALPHA = 0.05  # of tests; two one-sided tests at 5 % are a 90 % interval within the margin
# Relative difference between sums in different order; a feature that varies less is treated as constant.
ROUNDING = 1e-9
# Least number of repeats: deviations of two repeats from their median are equal, so every SD would seem different.
BROWN_FORSYTHE_REPEATS = 3


def common_features(simulated: pd.DataFrame, recorded: pd.DataFrame) -> list[str]:
    """Return the features that both tables have, in the order of the simulated one."""
    return [feature for feature in features_of(simulated) if feature in recorded]


def compare(
    simulated: pd.DataFrame,
    recorded: pd.DataFrame,
    features: Sequence[str],
    *,
    rois: Sequence[str] | None = None,
    margin_sd: float = MARGIN_SD,
    sd_factor: float = SD_FACTOR,
) -> pd.DataFrame:
    """Compare means and SDs over repeats, for every feature in every ROI.

    A constant recording has no repeat SD: the shift is then 0 or infinite, the ratio infinite (missing if both are
    constant), and intervals are missing. Two equal constants agree.

    Parameters
    ----------
    simulated, recorded : DataFrame
        One row per image and ROI, with columns roi, tissue_class and `features`. All images of a table are repeats of
        one scan.
    rois : sequence of str, optional
        ROIs to compare. By default all ROIs, which both tables must then have.
    margin_sd : float, optional
        Largest shift that counts as agreement, in repeat SDs.
    sd_factor : float, optional
        Largest ratio of SDs (or its inverse) that counts as agreement.

    Returns
    -------
    DataFrame
        One row per ROI (in the recording's order) and feature:

        * roi, tissue_class, feature, family, n_simulated, n_recorded, mean_*, sd_* (n - 1)
        * shift_sd: (mean_simulated - mean_recorded)/sd_recorded, with shift_lower and shift_upper (95 %): MOVER of the
          Welch interval of the difference and the chi-square interval of the SD, so that the uncertainty of the unit
          counts [1]_
        * sd_ratio: sd_simulated/sd_recorded, with sd_ratio_lower and sd_ratio_upper (95 %, F distribution; normal
          repeats are assumed here, not in p_sd)
        * p_mean, p_sd: Welch's t test, and the Brown-Forsythe test [2]_ (missing for fewer than three repeats); then
          over all ROIs and features q_* (false discovery rate, Benjamini and Yekutieli [3]_, valid for any
          dependence of features) and holm_* (family-wise, Holm [4]_)
        * mean_equivalent, sd_equivalent: the 90 % interval lies within the margin
        * mean_agrees, sd_agrees: "yes" if equivalent, "no" if q is under 0.05 and it is not, else "undecided"
        * margin_sd, sd_factor

    Raises
    ------
    InputError
        If an ROI or feature is in one table only, or tissue classes differ. Also if an ROI has fewer than two repeats,
        a margin is out of range, or a value is not finite.

    References
    ----------
    .. [1] Donner and Zou, Stat. Methods Med. Res. 21, 347, 2012.
    .. [2] Brown and Forsythe, J. Am. Stat. Assoc. 69, 364, 1974.
    .. [3] Benjamini and Yekutieli, Ann. Stat. 29, 1165, 2001.
    .. [4] Holm, Scand. J. Stat. 6, 65, 1979.
    """
    if not margin_sd > 0 or not sd_factor > 1:
        raise InputError(
            f"comparison: margin_sd {margin_sd} must be positive and sd_factor {sd_factor} larger than one"
        )
    rois = common_rois(simulated, recorded, rois)
    parts = []
    simulated_values, recorded_values = (
        samples(table, features, rois, source)
        for table, source in ((simulated, "simulated features"), (recorded, "recorded features"))
    )
    classes = _tissue_classes(simulated, recorded, rois)
    for roi in rois:
        part = _compare_roi(simulated_values[roi], recorded_values[roi], margin_sd, sd_factor)
        keys = {
            "roi": roi,
            "tissue_class": classes[roi],
            "feature": list(features),
            "family": [family(feature) for feature in features],
        }
        parts.append(pd.DataFrame(keys | part))
    table = pd.concat(parts, ignore_index=True)
    for kind in ("mean", "sd"):
        p = table[f"p_{kind}"].to_numpy()
        tested = np.isfinite(p)
        q, family_wise = np.full(p.shape, np.nan), np.full(p.shape, np.nan)
        if tested.any():
            q[tested] = benjamini_yekutieli(p[tested])
            family_wise[tested] = holm(p[tested])
        table = table.assign(**{f"q_{kind}": q, f"holm_{kind}": family_wise})
        equivalent = table[f"{kind}_equivalent"]
        table[f"{kind}_agrees"] = np.select([equivalent, q < ALPHA], ["yes", "no"], "undecided")
    table = table.assign(margin_sd=margin_sd, sd_factor=sd_factor)
    last = ["mean_equivalent", "sd_equivalent", "mean_agrees", "sd_agrees", "margin_sd", "sd_factor"]
    return table[[*table.columns.drop(last), *last]]


def common_rois(simulated: pd.DataFrame, recorded: pd.DataFrame, rois: Sequence[str] | None = None) -> list[str]:
    """Return the ROIs to compare: `rois`, or all in the order of the recording.

    Raises
    ------
    InputError
        If a table lacks one of these ROIs, or if there is no ROI.
    """
    have = {"simulated": list(simulated["roi"].unique()), "recorded": list(recorded["roi"].unique())}
    for side, other in (("simulated", "recorded"), ("recorded", "simulated")):
        wanted = have[other] if rois is None else rois
        if missing := [str(roi) for roi in wanted if roi not in have[side]]:
            advice = "; give the ROIs to compare as rois" if rois is None else ""
            raise InputError(f"comparison: the {side} features lack the ROI {', '.join(missing)}{advice}")
    chosen = have["recorded"] if rois is None else list(rois)
    if not chosen:
        raise InputError("comparison: there is no ROI to compare; the tables are empty or rois is")
    return chosen


def samples(table: pd.DataFrame, features: Sequence[str], rois: Sequence[str], source: str) -> dict[str, np.ndarray]:
    """Return the repeats of every ROI.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI.

    Returns
    -------
    dict of str to ndarray of float64, shape (images, features)
        By ROI, in the table's order.

    Raises
    ------
    InputError
        If a feature is missing or not finite, or an ROI has fewer than two repeats.
    """
    if missing := [feature for feature in features if feature not in table]:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(f"{source}: lack {missing[0]}{more}; compare only the features that both tables have")
    table = table[table["roi"].isin(rois)]
    values = finite_values(table, features, source)
    rows = table.groupby("roi", sort=False).indices
    for roi in rois:
        if len(rows[roi]) < COMPARED_REPEATS:
            raise InputError(
                f"{source}: {len(rows[roi])} image of ROI {roi}; a mean and an SD over repeats need at least "
                f"{COMPARED_REPEATS}"
            )
    return {roi: values[rows[roi]] for roi in rois}


def spread(values: np.ndarray) -> np.ndarray:
    """Return the SD (n - 1) over repeats (rows) of every feature; exactly 0 where only rounding varies."""
    sd = values.std(axis=0, ddof=1)
    return np.where(sd <= ROUNDING * np.abs(values).max(axis=0), 0.0, sd)


def in_sd(difference: np.ndarray, sd: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return a difference of means over an SD. For an SD of 0: 0 if the difference is rounding of `size`, else inf."""
    same = np.abs(difference) <= ROUNDING * size
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sd > 0, difference / sd, np.where(same, 0.0, np.copysign(np.inf, difference)))


def shift_interval(
    difference: np.ndarray, lower: np.ndarray, upper: np.ndarray, sd: np.ndarray, n: int, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the confidence interval of a difference of means over an estimated SD, by MOVER [1]_.

    Parameters
    ----------
    sd : ndarray
        Estimated from n normal values independently of the difference.

    References
    ----------
    .. [1] Donner and Zou, Stat. Methods Med. Res. 21, 347, 2012.
    """
    tail = (1 - level) / 2
    small, large = (sd * np.sqrt((n - 1) / scipy.stats.chi2.ppf(q, n - 1)) for q in (1 - tail, tail))

    def upper_limit(difference, upper):
        product = difference * sd
        limit = upper * (2 * difference - upper)
        # A positive limit is farthest out for a small SD, a negative one for a large SD.
        edge = np.where(upper > 0, small, large)
        a = edge * (2 * sd - edge)
        root = np.sqrt(np.maximum(product**2 - a * limit, 0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(upper > 0, (product + root) / a, limit / (product - root))

    return -upper_limit(-difference, -lower), upper_limit(difference, upper)


def ratio_interval(ratio: np.ndarray, n: int, m: int, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the confidence interval of a ratio of SDs of n and m normal values."""
    tail = (1 - level) / 2
    return tuple(ratio / np.sqrt(scipy.stats.f.ppf(q, n - 1, m - 1)) for q in (1 - tail, tail))


def _compare_roi(
    simulated_values: np.ndarray, recorded_values: np.ndarray, margin_sd: float, sd_factor: float
) -> dict[str, np.ndarray]:
    n, m = len(simulated_values), len(recorded_values)
    mean, mean_recorded = simulated_values.mean(axis=0), recorded_values.mean(axis=0)
    sd, sd_recorded = spread(simulated_values), spread(recorded_values)
    size = np.maximum(np.abs(simulated_values).max(axis=0), np.abs(recorded_values).max(axis=0))
    shift = in_sd(mean - mean_recorded, sd_recorded, size)
    unit = sd_recorded > 0
    constant = ~unit & (sd == 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(constant, np.nan, sd / sd_recorded)
        error, freedom = _welch(sd, n, sd_recorded, m)
        p_mean = 2 * scipy.stats.t.sf(np.abs(mean - mean_recorded) / error, freedom)
        p_mean = np.where(constant, shift == 0, p_mean)
        # Variation by rounding alone must not count as spread.
        simulated_values, recorded_values = (
            np.where(sd > 0, simulated_values, simulated_values[0]),
            np.where(unit, recorded_values, recorded_values[0]),
        )
        if min(n, m) < BROWN_FORSYTHE_REPEATS:
            p_sd = np.where(constant, 1.0, np.nan)
        else:
            p_sd = scipy.stats.levene(simulated_values, recorded_values, center="median", axis=0).pvalue
            p_sd = np.where(np.isnan(p_sd), 1.0, p_sd)  # all deviations are the same
    difference, unit_sd = mean - mean_recorded, np.where(unit, sd_recorded, np.nan)
    intervals = []
    for level in (LEVEL, 1 - 2 * ALPHA):
        half = scipy.stats.t.ppf((1 + level) / 2, freedom) * error
        intervals.append(shift_interval(difference, difference - half, difference + half, unit_sd, m, level))
    wide, narrow = intervals
    ratio_wide, ratio_narrow = (
        ratio_interval(np.where(unit, ratio, np.nan), n, m, level) for level in (LEVEL, 1 - 2 * ALPHA)
    )
    return {
        "n_simulated": n,
        "n_recorded": m,
        "mean_simulated": mean,
        "mean_recorded": mean_recorded,
        "sd_simulated": sd,
        "sd_recorded": sd_recorded,
        "shift_sd": shift,
        "shift_lower": wide[0],
        "shift_upper": wide[1],
        "sd_ratio": ratio,
        "sd_ratio_lower": ratio_wide[0],
        "sd_ratio_upper": ratio_wide[1],
        "p_mean": p_mean.astype(np.float64),
        "p_sd": p_sd,
        "mean_equivalent": ((narrow[0] >= -margin_sd) & (narrow[1] <= margin_sd)) | (constant & (shift == 0)),
        "sd_equivalent": ((ratio_narrow[0] >= 1 / sd_factor) & (ratio_narrow[1] <= sd_factor)) | constant,
    }


def _welch(a: np.ndarray, n: int, b: np.ndarray, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standard error and degrees of freedom of a difference of means (Welch, Biometrika 34, 28, 1947)."""
    first, second = a**2 / n, b**2 / m
    return np.sqrt(first + second), (first + second) ** 2 / (first**2 / (n - 1) + second**2 / (m - 1))


def _tissue_classes(simulated: pd.DataFrame, recorded: pd.DataFrame, rois: Sequence[str]) -> dict[str, str]:
    classes = {}
    for roi in rois:
        found = {
            str(name)
            for table in (simulated, recorded)
            for name in table.loc[table["roi"] == roi, "tissue_class"].unique()
        }
        if len(found) > 1:
            raise InputError(f"comparison: ROI {roi} has tissue class {' and '.join(sorted(found))}; use one name")
        classes[roi] = found.pop()
    return classes
