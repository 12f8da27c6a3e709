"""The highest-scoring features, and how far two rankings agree.

Scores are fractions of a few dozen comparisons, so many features tie. Where a list must be printed, ties
stand in the order of feature_names.FEATURES and are marked. Where two lists are compared, the order within a tie
is taken as random.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import hypergeom

from ..errors import InputError

KINDS = ("stability", "discrimination")


def top(scores: pd.DataFrame, published: pd.DataFrame, n: int = 10) -> pd.DataFrame:
    """The n most stable and most discriminative features beside the published ones.

    scores      from `wilcoxon.scores`
    published   kind, rank, source (simulator | phantom), feature
    Returns per rank and kind: {kind}_simulated, {kind}_simulated_percent, {kind}_simulated_tied (how many
    features share the score: where this is more than one, rank and even membership follow the order of names,
    not merit), {kind}_published_simulator, {kind}_published_phantom.
    Raises InputError if scores lack a column or are not finite.
    """
    _check(scores, "scores of the simulation")
    columns: dict[str, object] = {"rank": np.arange(1, n + 1)}
    for kind in KINDS:
        percent = scores[f"{kind}_percent"]
        best = percent.sort_values(ascending=False, kind="stable").index[:n]
        columns[f"{kind}_simulated"] = scores.loc[best, "feature"].to_numpy()
        columns[f"{kind}_simulated_percent"] = percent[best].to_numpy()
        columns[f"{kind}_simulated_tied"] = percent[best].map(percent.value_counts()).to_numpy()
        for source in ("simulator", "phantom"):
            chosen = (published["kind"] == kind) & (published["source"] == source)
            column = published[chosen].set_index("rank")
            columns[f"{kind}_published_{source}"] = column["feature"].reindex(columns["rank"]).to_numpy()
    return pd.DataFrame(columns)


def membership(scores: np.ndarray, n: int) -> np.ndarray:
    """Probability that each item is among the n highest of `scores`, ties broken at random: 1 above the n-th
    highest score, 0 below, and within the tie across the cut the share of places left."""
    scores = np.asarray(scores, dtype=np.float64)
    cut = np.sort(scores)[-n]
    above, tied = scores > cut, scores == cut
    return above + tied * (n - above.sum()) / tied.sum()


def expected_overlap(a: np.ndarray, b: np.ndarray, n: int) -> float:
    """Mean number of items that the n highest of two lists of scores share, ties in each list broken at
    random, independently. Without ties it is the plain count."""
    return float(membership(a, n) @ membership(b, n))


def uncorrelated_overlap(items: int, n: int, level: float = 0.95) -> tuple[float, float, float]:
    """Mean, lower and upper bound of the overlap of two unrelated choices of n among `items`.

    The overlap is hypergeometric, with mean n^2 / items; the bounds are its (1 - level)/2 and (1 + level)/2
    quantiles.
    """
    lower, upper = hypergeom.ppf([(1 - level) / 2, (1 + level) / 2], items, n, n)
    return n * n / items, float(lower), float(upper)


def overlap(simulated: pd.DataFrame, measured: pd.DataFrame) -> pd.DataFrame:
    """Overlap of the n best simulated and measured features, for every n, as in the paper's overlap figure.

    Both tables hold feature, stability_percent and discrimination_percent; features of only one of them are
    left out (the measured scores come from 2D regions, for which pyradiomics gives no TotalEnergy).
    Returns one row per n: n_top, percent (of the common features), overlap_{kind}_percent (of n),
    expected_percent, lower_percent and upper_percent (two unrelated lists without ties: mean and central
    95 %; averaging over ties makes the overlap of unrelated lists vary less, so the band is on the safe
    side), and, the same in every row, area_{kind} and area_expected: means over n of the three curves (1 is
    full agreement), and n_features.
    Raises InputError if a table lacks a column or holds scores that are not finite, or they share fewer than two
    features.
    """
    _check(simulated, "scores of the simulation")
    _check(measured, "measured scores")
    common = [feature for feature in simulated["feature"] if feature in set(measured["feature"])]
    if len(common) < 2:
        raise InputError(f"overlap: the two tables of scores share {len(common)} features")
    simulated, measured = (table.set_index("feature").loc[common] for table in (simulated, measured))
    n_top = np.arange(1, len(common) + 1)
    expected, lower, upper = np.array([uncorrelated_overlap(len(common), n) for n in n_top]).T
    result = pd.DataFrame({"n_top": n_top, "percent": 100 * n_top / len(common)})
    for kind in KINDS:
        shared = [expected_overlap(simulated[f"{kind}_percent"], measured[f"{kind}_percent"], n) for n in n_top]
        result[f"overlap_{kind}_percent"] = 100 * np.array(shared) / n_top
    for name, count in (("expected", expected), ("lower", lower), ("upper", upper)):
        result[f"{name}_percent"] = 100 * count / n_top
    for kind in KINDS:
        result[f"area_{kind}"] = result[f"overlap_{kind}_percent"].mean() / 100
    return result.assign(area_expected=result["expected_percent"].mean() / 100, n_features=len(common))


def _check(scores: pd.DataFrame, name: str) -> None:
    columns = [f"{kind}_percent" for kind in KINDS]
    if missing := [column for column in ("feature", *columns) if column not in scores]:
        raise InputError(f"{name}: lacks the column {missing[0]}; make the table anew")
    if not np.isfinite(scores[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)).all():
        raise InputError(f"{name}: holds values that are not finite numbers; make the table anew")
