"""How far simulated features lie from those of a recording, in units of the recording's own repeatability.

A difference that is not significant may only be badly measured, so agreement is claimed by equivalence alone: an
interval that lies within a margin (two one-sided tests [1]_). What is neither equivalent nor significantly different
is undecided.

References
----------
.. [1] Schuirmann, J. Pharmacokinet. Biopharm. 15, 657, 1987.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from ..features.names import (
    EVERY_FAMILY,
    FAMILIES,
    HISTOGRAM_ONLY,
    OTHER_FAMILIES,
    family,
    features_of,
    is_feature,
    unfiltered,
)
from ..features.settings import SETTINGS
from ..features.tables import finite_values
from . import COMPARED_REPEATS
from .multiplicity import benjamini_yekutieli, holm

# One repeat SD: a single scan of the recording is off its mean by as much in one of three cases anyway.
MARGIN_SD = 1.0
# With ten repeats each, the 90 % interval of a ratio of SDs is a factor of 1.8 wide to either side; a narrower margin
# than half to twice could hardly ever be shown to be kept.
SD_FACTOR = 2.0
LEVEL = 0.95  # of intervals
ALPHA = 0.05  # of tests; two one-sided tests at 5 % are a 90 % interval within the margin
# Relative: sums in another order differ by as much, and a feature that varies less is constant.
ROUNDING = 1e-9
# About their median, both deviations of two repeats are equal: the test would find every SD different.
BROWN_FORSYTHE_REPEATS = 3
MINIMUM_ROIS = 3  # two can only be in the right order or not, each by a chance of one half
# Kendall's tau of six ROIs with 2 of their 15 pairs swapped is 0.73; chance alone puts them as well in 2.8 %.
RANK_RIGHT = 0.7
MOST = 0.8  # of the ROIs: one of six may miss

SHIFTED = tuple(
    f"original_firstorder_{name}"
    for name in "10Percentile 90Percentile Energy Maximum Mean Median Minimum RootMeanSquared TotalEnergy".split()
)
# Sums over all voxels, runs or zones that are not divided by their number (Energy, non-uniformities), and powers of
# the size of zones that span the ROI, as those of frequent grey levels do: with 26 neighbours, 10 % of the voxels at
# random are enough to percolate.
SIZED = (
    "original_firstorder_Energy",
    "original_firstorder_TotalEnergy",
    "original_gldm_DependenceNonUniformity",
    "original_gldm_GrayLevelNonUniformity",
    "original_glrlm_GrayLevelNonUniformity",
    "original_glrlm_RunLengthNonUniformity",
    "original_glszm_GrayLevelNonUniformity",
    "original_glszm_LargeAreaEmphasis",
    "original_glszm_LargeAreaHighGrayLevelEmphasis",
    "original_glszm_LargeAreaLowGrayLevelEmphasis",
    "original_glszm_SizeZoneNonUniformity",
    "original_glszm_ZoneVariance",
)
SHAPES = (OTHER_FAMILIES["shape"], OTHER_FAMILIES["shape2D"])
SAME_VOXELS = 1e-3  # relative difference of their number or volume; the features give both to rounding
# Columns that tell how many voxels an ROI has: of our tables, and of pyradiomics' after resampling and before.
COUNTS = ("n_voxels", "diagnostics_Mask-interpolated_VoxelNum", "diagnostics_Mask-original_VoxelNum")
COMPARABLE = ("yes", "with care", "no")


def common_features(simulated: pd.DataFrame, recorded: pd.DataFrame) -> list[str]:
    """Features that both tables have, in the order of the simulated one."""
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
    """Means and SDs over repeats of every feature in every ROI, simulated against recorded.

    A recording that is constant gives no unit: the shift is then 0 or infinite, the ratio infinite (missing if both are
    constant), and intervals are missing; two equal constants agree.

    Parameters
    ----------
    simulated, recorded : DataFrame
        One row per image and ROI, with columns roi, tissue_class and `features`; all images of a table are repeats of
        one scan.
    features : sequence of str
    rois : sequence of str, optional
        Which to compare; None for all, which must then be those of both tables.
    margin_sd, sd_factor : float, optional
        What counts as agreement: a shift of as many repeat SDs, an SD larger or smaller by a factor.

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
          over all ROIs and features q_* (false discovery rate, Benjamini and Yekutieli [3]_: valid however features
          depend on each other) and holm_* (family-wise, Holm [4]_)
        * mean_equivalent, sd_equivalent: the 90 % interval lies within the margin
        * mean_agrees, sd_agrees: "yes" if equivalent, "no" if q is under 0.05 and it is not, else "undecided"
        * margin_sd, sd_factor: as given

    Raises
    ------
    InputError
        For ROIs or features of one table only, tissue classes that differ, fewer than two repeats of an ROI, margins
        that are none, or values that are not finite.

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
    ours, theirs = (
        samples(table, features, rois, source)
        for table, source in ((simulated, "simulated features"), (recorded, "recorded features"))
    )
    classes = _tissue_classes(simulated, recorded, rois)
    for roi in rois:
        part = _compare_roi(ours[roi], theirs[roi], margin_sd, sd_factor)
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
    """The ROIs to compare, in the recording's order, or as asked for.

    Parameters
    ----------
    simulated, recorded : DataFrame
        With a column roi.
    rois : sequence of str, optional
        Those asked for.

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        Naming those that only one of the tables has and that were not left out by `rois`, or if nothing is left.
    """
    have = {"simulated": list(simulated["roi"].unique()), "recorded": list(recorded["roi"].unique())}
    for side, other in (("simulated", "recorded"), ("recorded", "simulated")):
        wanted = have[other] if rois is None else rois
        if lacking := [str(roi) for roi in wanted if roi not in have[side]]:
            advice = "; give the ROIs to compare as rois" if rois is None else ""
            raise InputError(f"comparison: the {side} features lack the ROI {', '.join(lacking)}{advice}")
    chosen = have["recorded"] if rois is None else list(rois)
    if not chosen:
        raise InputError("comparison: there is no ROI to compare; the tables are empty or rois is")
    return chosen


def samples(table: pd.DataFrame, features: Sequence[str], rois: Sequence[str], source: str) -> dict[str, np.ndarray]:
    """The repeats of every ROI.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI.
    features, rois : sequence of str
    source : str
        What the message begins with.

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
    """SD (n - 1) over repeats (rows) of every feature, exactly 0 where only rounding varies."""
    sd = values.std(axis=0, ddof=1)
    return np.where(sd <= ROUNDING * np.abs(values).max(axis=0), 0.0, sd)


def in_sd(difference: np.ndarray, sd: np.ndarray, size: np.ndarray) -> np.ndarray:
    """A difference of means over an SD; over one of 0 infinite, or 0 if it is but rounding of values of `size`."""
    same = np.abs(difference) <= ROUNDING * size
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sd > 0, difference / sd, np.where(same, 0.0, np.copysign(np.inf, difference)))


def shift_interval(
    difference: np.ndarray, lower: np.ndarray, upper: np.ndarray, sd: np.ndarray, n: int, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of a difference of means over an SD, both uncertain, by MOVER [1]_.

    Parameters
    ----------
    difference, lower, upper : ndarray
        The difference and its interval of this level.
    sd : ndarray
        Estimated from n normal values independently of the difference.
    n : int
    level : float
        From 0 to 1.

    Returns
    -------
    lower, upper : ndarray

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
    """Interval of a ratio of SDs of n and m normal values."""
    tail = (1 - level) / 2
    return tuple(ratio / np.sqrt(scipy.stats.f.ppf(q, n - 1, m - 1)) for q in (1 - tail, tail))


def _compare_roi(ours: np.ndarray, theirs: np.ndarray, margin_sd: float, sd_factor: float) -> dict[str, np.ndarray]:
    n, m = len(ours), len(theirs)
    mean, mean_recorded = ours.mean(axis=0), theirs.mean(axis=0)
    sd, sd_recorded = spread(ours), spread(theirs)
    size = np.maximum(np.abs(ours).max(axis=0), np.abs(theirs).max(axis=0))
    shift = in_sd(mean - mean_recorded, sd_recorded, size)
    unit = sd_recorded > 0
    constant = ~unit & (sd == 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(constant, np.nan, sd / sd_recorded)
        error, freedom = _welch(sd, n, sd_recorded, m)
        p_mean = 2 * scipy.stats.t.sf(np.abs(mean - mean_recorded) / error, freedom)
        p_mean = np.where(constant, shift == 0, p_mean)
        # Rounding must not pass for spread.
        ours, theirs = np.where(sd > 0, ours, ours[0]), np.where(unit, theirs, theirs[0])
        if min(n, m) < BROWN_FORSYTHE_REPEATS:
            p_sd = np.where(constant, 1.0, np.nan)
        else:
            p_sd = scipy.stats.levene(ours, theirs, center="median", axis=0).pvalue
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
    """Standard error of a difference of means, and degrees of freedom (Welch, Biometrika 34, 28, 1947), from SDs."""
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
            raise InputError(f"comparison: ROI {roi} is of tissue class {' and '.join(sorted(found))}; name one alike")
        classes[roi] = found.pop()
    return classes


def ranks(table: pd.DataFrame) -> pd.DataFrame:
    """Whether each feature orders the ROIs as it was measured to.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    DataFrame
        One row per feature: feature, family, rois, kendall_tau (tau-b), kendall_p (two-sided, exact without ties),
        spearman. They are of the means over repeats, so a pair of ROIs that the recording itself hardly tells apart
        counts as any other. Missing where either side is the same in all ROIs.

    Raises
    ------
    InputError
        For fewer than three ROIs.
    """
    if (count := table["roi"].nunique()) < MINIMUM_ROIS:
        raise InputError(f"comparison: {count} ROIs; an order of ROIs needs at least {MINIMUM_ROIS}")
    rows = []
    for feature, part in table.groupby("feature", sort=False):
        pair = part["mean_simulated"].to_numpy(), part["mean_recorded"].to_numpy()
        row = {"feature": feature, "family": family(feature), "rois": len(part)}
        if any(np.ptp(means) <= ROUNDING * np.abs(means).max() for means in pair):
            rows.append(row | {"kendall_tau": np.nan, "kendall_p": np.nan, "spearman": np.nan})
            continue
        tau = scipy.stats.kendalltau(*pair)
        rows.append(
            row
            | {
                "kendall_tau": float(tau.statistic),
                "kendall_p": float(tau.pvalue),
                "spearman": float(scipy.stats.spearmanr(*pair).statistic),
            }
        )
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """What `compare` says of each feature, over its ROIs.

    The verdict is of what was found, not of what is certain: beside it stand the shares that equivalence was shown for.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    DataFrame
        One row per feature: feature, family, rois, median_abs_shift_sd, share_within_margin (of the ROIs: |shift|
        within the margin, whether or not that is certain), share_equivalent (shown to be), share_mean_differs (q under
        0.05), median_sd_ratio, share_sd_within, share_sd_equivalent, share_sd_differs, kendall_tau, spearman (missing
        for fewer than three ROIs), and mean_right, sd_right (in at least MOST of the ROIs within the margin),
        rank_right (tau of at least RANK_RIGHT) and their sum as `verdict`: "mean, SD and rank right" to "none right".
    """
    cells = _cells(table)
    result = _shares(cells.groupby(["feature", "family"], sort=False)).reset_index()
    result.insert(2, "rois", cells.groupby("feature", sort=False)["roi"].nunique().to_numpy())
    if table["roi"].nunique() >= MINIMUM_ROIS:
        order = ranks(table).set_index("feature")[["kendall_tau", "spearman"]]
        result = result.join(order, on="feature")
    else:
        result = result.assign(kendall_tau=np.nan, spearman=np.nan)
    result["mean_right"] = result["share_within_margin"] >= MOST
    result["sd_right"] = result["share_sd_within"] >= MOST
    result["rank_right"] = result["kendall_tau"] >= RANK_RIGHT
    right = result[["mean_right", "sd_right", "rank_right"]].to_numpy()
    result["verdict"] = [_verdict(row) for row in right]
    return result


def family_summary(table: pd.DataFrame) -> pd.DataFrame:
    """The same of each family and, last, of "all" features: medians and shares are over all its features and ROIs.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    DataFrame
        One row per family: family, features, the columns of `summary` from median_abs_shift_sd to share_sd_differs,
        median_kendall_tau, and of its features share_mean_right, share_sd_right, share_rank_right and share_all_right.
    """
    cells, each = _cells(table), summary(table)
    rows = []
    for name in (*EVERY_FAMILY.values(), "all"):
        part = cells if name == "all" else cells[cells["family"] == name]
        own = each if name == "all" else each[each["family"] == name]
        if own.empty:
            continue
        right = own[["mean_right", "sd_right", "rank_right"]]
        rows.append(
            {"family": name, "features": len(own)}
            | _shares(part.assign(whole=0).groupby("whole")).iloc[0].to_dict()
            | {"median_kendall_tau": own["kendall_tau"].median()}
            | {f"share_{column}": right[column].mean() for column in right}
            | {"share_all_right": right.all(axis=1).mean()}
        )
    return pd.DataFrame(rows)


def _cells(table: pd.DataFrame) -> pd.DataFrame:
    """One row per ROI and feature with what is counted; two constants have no ratio and spread alike."""
    ratio = table["sd_ratio"].where((table["sd_simulated"] > 0) | (table["sd_recorded"] > 0), 1.0)
    shift = table["shift_sd"].abs()
    return pd.DataFrame(
        {
            "feature": table["feature"],
            "family": table["family"],
            "roi": table["roi"],
            "shift": shift,
            "within": shift <= table["margin_sd"],
            "equivalent": table["mean_equivalent"],
            "differs": table["q_mean"] < ALPHA,
            "ratio": ratio,
            "sd_within": ratio.between(1 / table["sd_factor"], table["sd_factor"]),
            "sd_equivalent": table["sd_equivalent"],
            "sd_differs": table["q_sd"] < ALPHA,
        }
    )


def _shares(groups) -> pd.DataFrame:
    return groups.agg(
        median_abs_shift_sd=("shift", "median"),
        share_within_margin=("within", "mean"),
        share_equivalent=("equivalent", "mean"),
        share_mean_differs=("differs", "mean"),
        median_sd_ratio=("ratio", "median"),
        share_sd_within=("sd_within", "mean"),
        share_sd_equivalent=("sd_equivalent", "mean"),
        share_sd_differs=("sd_differs", "mean"),
    )


def _verdict(right: Sequence[bool]) -> str:
    names = [name for name, good in zip(("mean", "SD", "rank"), right, strict=True) if good]
    if not names:
        return "none right"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names) + " right"


def comparable(
    features: Sequence[str],
    recording_dimensions: int,
    stored_offset: float,
    *,
    same_voxels: bool = False,
    other_settings: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Which features of a recording may be compared with those of a 3D simulation in HU.

    Parameters
    ----------
    features : sequence of str
    recording_dimensions : {2, 3}
        2 if they were extracted from single slices.
    stored_offset : float
        HU that were added before extraction.
    same_voxels : bool, optional
        Both were extracted from ROIs of the same voxels on the same grid.
    other_settings : mapping of str to str, optional
        {feature: settings of its extraction that are not the study's} (features.settings.other_settings).

    Returns
    -------
    DataFrame
        One row per feature: feature, family; flags by pyradiomics' definitions [1]_:

        * needs_hu: the value itself moves with the offset, and features.stored.to_hu brings it back
        * depends_on_bin_edges: bins of 25 start at multiples of 25: an offset that is none moves the edges by a
          fraction of a bin (1024: by one HU), for Entropy, Uniformity and all textures
        * depends_on_size: grows with the ROI: with its voxels, or (TotalEnergy) with its volume in mm^3
        * depends_on_voxel_size: counts neighbours or voxels, so that the same object on another grid gives another
          value
        * depends_on_dimensions: in a slice there are 8 neighbours, in a volume 26

        and comparable, "yes", "with care" or "no", with the reason. "no" are: features of other settings; those that
        depend on size unless same_voxels; and of slices, dependences and zones, whose counts of neighbours differ.
        Co-occurrences and runs in a slice are averaged over 4 directions instead of 13, which is the same in
        expectation only if texture and voxels are isotropic: with care. Voxel sizes are not known here:
        depends_on_voxel_size alone gives no reason.

    Raises
    ------
    InputError
        For dimensions other than 2 and 3, or unknown features.

    References
    ----------
    .. [1] van Griethuysen et al., Cancer Res. 77, e104, 2017; https://pyradiomics.readthedocs.io, "Radiomic Features".
    """
    if recording_dimensions not in (2, 3):
        raise InputError(f"comparison: dimensions is {recording_dimensions}; features are of 2 or 3 dimensions")
    if unknown := [feature for feature in features if not is_feature(feature)]:
        raise InputError(f"comparison: unknown feature {unknown[0]}; it is named as none of pyradiomics is")
    rows = []
    for feature in features:
        alike = unfiltered(feature)
        shape = family(feature) in SHAPES
        texture = family(feature) != FAMILIES["firstorder"] and not shape
        binned = texture or feature.endswith(("_Entropy", "_Uniformity"))
        neighbours = texture and alike not in HISTOGRAM_ONLY
        row = {
            "feature": feature,
            "family": family(feature),
            "needs_hu": stored_offset != 0 and feature in SHIFTED,
            "depends_on_bin_edges": binned and stored_offset % SETTINGS["binWidth"] != 0,
            "depends_on_size": grows_with_roi(feature),
            "depends_on_voxel_size": neighbours or shape or (alike in SIZED and not feature.endswith("_TotalEnergy")),
            "depends_on_dimensions": neighbours and recording_dimensions == 2,
        }
        counted = family(feature) in (FAMILIES["gldm"], FAMILIES["glszm"])
        if other := (other_settings or {}).get(feature):
            verdict = "no", f"extracted with other settings: {other}"
        elif stored_offset != 0 and alike != feature:
            verdict = "no", "a filtered image of another offset"
        elif row["depends_on_size"] and not (same_voxels and recording_dimensions == 3):
            verdict = "no", "grows with the ROI"
        elif row["depends_on_dimensions"] and counted:
            verdict = "no", "neighbours are counted in a slice"
        elif row["depends_on_dimensions"]:
            verdict = "with care", "directions of a slice only"
        elif row["depends_on_bin_edges"]:
            verdict = "with care", "bin edges differ by a fraction of a bin"
        else:
            verdict = "yes", "after conversion to HU" if row["needs_hu"] else ""
        rows.append(row | dict(zip(("comparable", "reason"), verdict, strict=True)))
    return pd.DataFrame(rows)


def grows_with_roi(feature: str) -> bool:
    """Whether a feature grows with its ROI, by its voxels or its volume."""
    return unfiltered(feature) in SIZED or family(feature) in SHAPES


def other_sizes(
    simulated: pd.DataFrame, recorded: pd.DataFrame, features: Sequence[str], rois: Sequence[str]
) -> dict[str, str]:
    """Features that grow with the ROI, where its voxels are others in a recording.

    Parameters
    ----------
    simulated, recorded : DataFrame
        One row per image and ROI. They tell the voxels of their ROIs by Energy and RootMeanSquared (`roi_sizes`), or by
        a column of COUNTS; of a table that does neither nothing is known and nothing is said.
    features, rois : sequence of str
        Those that are compared.

    Returns
    -------
    dict of str to str
        {feature: the voxels of both in words}.
    """
    ours, theirs = (_sizes(table, rois) for table in (simulated, recorded))
    if ours is None or theirs is None:
        return {}
    count, volume = (ours[name] / theirs[name] for name in ("n_voxels", "voxel_mm3"))
    # Without TotalEnergy the voxels' volume is not known, and taken to be the same.
    if (np.abs(pd.concat([count, volume]).dropna() - 1) < SAME_VOXELS).all():
        return {}
    words = f"{_sized(theirs)}, the study's {_sized(ours)}"
    return {feature: words for feature in features if grows_with_roi(feature)}


def _sizes(table: pd.DataFrame, rois: Sequence[str]) -> pd.DataFrame | None:
    """As `roi_sizes`, by ROI; None where the table does not tell."""
    table = table[table["roi"].isin(rois)]
    if {"original_firstorder_Energy", "original_firstorder_RootMeanSquared"} <= set(table.columns):
        return roi_sizes(table).set_index("roi")
    column = next((name for name in COUNTS if name in table), None)
    if column is None:
        return None
    counts = pd.DataFrame({"roi": table["roi"], "n_voxels": pd.to_numeric(table[column], errors="coerce")})
    return counts.groupby("roi", sort=False).median().assign(voxel_mm3=np.nan)


def _sized(sizes: pd.DataFrame) -> str:
    low, high = (f"{one:.0f}" for one in (sizes["n_voxels"].min(), sizes["n_voxels"].max()))
    of = "" if sizes["voxel_mm3"].isna().all() else f" of {sizes['voxel_mm3'].median():.3g} mm³"
    return f"{low if low == high else f'{low} to {high}'} voxels{of}"


def roi_sizes(table: pd.DataFrame) -> pd.DataFrame:
    """Number and size of each ROI's voxels, which the features themselves tell.

    Energy is N RootMeanSquared^2, and TotalEnergy is Energy times the voxel's volume.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI.

    Returns
    -------
    DataFrame
        One row per ROI: roi, n_voxels (median over images), voxel_mm3 (missing without TotalEnergy).

    Raises
    ------
    InputError
        If Energy or RootMeanSquared is missing.
    """
    energy, square = "original_firstorder_Energy", "original_firstorder_RootMeanSquared"
    for name in (energy, square):
        if name not in table:
            raise InputError(f"features: {name} is missing; the size of the ROIs cannot be told without it")
    total = table.get("original_firstorder_TotalEnergy", pd.Series(np.nan, table.index))
    sizes = pd.DataFrame(
        {"roi": table["roi"], "n_voxels": table[energy] / table[square] ** 2, "voxel_mm3": total / table[energy]}
    )
    return sizes.groupby("roi", sort=False).median().reset_index()
