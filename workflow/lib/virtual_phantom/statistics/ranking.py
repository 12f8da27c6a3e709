"""The highest-scoring features, and how far two rankings agree.

Scores are fractions of a few dozen comparisons, so many features tie. Where a list must be printed, ties
stand in the order of names.FEATURES and are marked. Where two lists are compared, the order within a tie
is taken as random.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..base.streams import generator
from .repeats import share_drawn, spread

KINDS = ("stability", "discrimination")
UNRELATED = 2000  # random lists: the ends of a 95 % band are then those of 94 to 96 %
NULL_SEED = 86  # of the stream of random lists, the same in every study


def top(
    scores: pd.DataFrame, published: pd.DataFrame | None = None, measured: pd.DataFrame | None = None, n: int = 10
) -> pd.DataFrame:
    """The n most stable and most discriminative features beside the measured and published ones.

    Parameters
    ----------
    scores : DataFrame
        From `wilcoxon.scores`.
    published : DataFrame, optional
        Columns kind, rank, source (simulator | phantom), feature.
    measured : DataFrame, optional
        From `repeats.draws`: the best by their means over draws.
    n : int, optional
        Fewer where fewer features were scored.

    Returns
    -------
    DataFrame
        Per rank and kind: {kind}_simulated, {kind}_simulated_percent, {kind}_simulated_tied (how many features share
        the score: where this is more than one, rank and even membership follow the order of names, not merit),
        {kind}_measured, {kind}_measured_percent and {kind}_measured_sd (with `measured`), {kind}_published_simulator
        and {kind}_published_phantom (with `published`).

    Raises
    ------
    InputError
        If scores lack a column or are not finite.
    """
    _check(scores, "scores of the simulation")
    if measured is not None:
        _check(measured, "measured scores")
    n = min(n, len(scores))
    columns: dict[str, object] = {"rank": np.arange(1, n + 1)}
    for kind in KINDS:
        percent = scores[f"{kind}_percent"]
        best = percent.sort_values(ascending=False, kind="stable").index[:n]
        columns[f"{kind}_simulated"] = scores.loc[best, "feature"].to_numpy()
        columns[f"{kind}_simulated_percent"] = percent[best].to_numpy()
        columns[f"{kind}_simulated_tied"] = percent[best].map(percent.value_counts()).to_numpy()
        if measured is not None:
            drawn = measured.pivot(index="draw", columns="feature", values=f"{kind}_percent")
            best = drawn[measured["feature"].unique()].mean().sort_values(ascending=False, kind="stable").index[:n]
            columns[f"{kind}_measured"] = best.to_numpy()
            columns[f"{kind}_measured_percent"] = drawn[best].mean().to_numpy()
            columns[f"{kind}_measured_sd"] = spread(drawn[best].to_numpy(), share_drawn(measured))
        for source in ("simulator", "phantom") if published is not None else ():
            chosen = (published["kind"] == kind) & (published["source"] == source)
            column = published[chosen].set_index("rank")
            columns[f"{kind}_published_{source}"] = column["feature"].reindex(columns["rank"]).to_numpy()
    return pd.DataFrame(columns)


def membership(scores: np.ndarray, n: int) -> np.ndarray:
    """Probability that each item is among the n highest scores, ties broken at random.

    Parameters
    ----------
    scores : array_like, shape (items,)

    Returns
    -------
    ndarray, shape (items,)
        1 above the n-th highest score, 0 below, and within the tie across the cut the share of places left.
    """
    scores = np.asarray(scores, dtype=np.float64)
    cut = np.sort(scores)[-n]
    above, tied = scores > cut, scores == cut
    return above + tied * (n - above.sum()) / tied.sum()


def heads(scores: np.ndarray) -> np.ndarray:
    """`membership` for every n, shape (lengths, items)."""
    return np.array([membership(scores, n) for n in range(1, len(scores) + 1)])


def expected_overlap(a: np.ndarray, b: np.ndarray, n: int) -> float:
    """Mean number of items that the n highest of two lists of scores share.

    Ties in each list are broken at random, independently. Without ties it is the plain count.
    """
    return float(membership(a, n) @ membership(b, n))


def shared_variance(table: pd.DataFrame, features: Sequence[str]) -> pd.DataFrame:
    """How much of their order every two features share.

    The square of Spearman's coefficient over all rows of an ROI, as a mean over ROIs. A feature that does not vary in
    an ROI shares nothing there.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns roi and `features`, finite.

    Returns
    -------
    DataFrame, shape (features, features)
        Symmetric.
    """
    squares = np.zeros((len(features), len(features)))
    rois = [rows[list(features)].rank().to_numpy() for _, rows in table.groupby("roi")]
    for ranks in rois:
        ranks = ranks - ranks.mean(axis=0)
        length = np.sqrt(np.square(ranks).sum(axis=0))
        ranks = ranks / np.where(length > 0, length, 1)
        squares += np.square(ranks.T @ ranks)
    squares /= len(rois)
    np.fill_diagonal(squares, 1)
    return pd.DataFrame(squares, index=list(features), columns=list(features))


def unrelated_overlaps(heads: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Overlaps, for every length, of UNRELATED random lists with a given one.

    Features that order images alike rank alike, whatever they are worth. A random list is a draw of scores from a
    normal distribution whose correlations are the squares of the features': a score counts |W| over many pairs of
    groups, and where groups differ in nothing the scores of two features correlate by 0.95 of that square (r = 0.95
    over all pairs of features of the measured table, its groups permuted; tests/statistics/test_statistics_ranking.py).

    Parameters
    ----------
    heads : ndarray, shape (lengths, items)
        Probability that an item is among the n highest (rows, n = 1, 2, ...) of the given list.
    shared : ndarray, shape (items, items)
        Covariance of the items' scores in a random list: `shared_variance`.

    Returns
    -------
    ndarray, shape (lists, lengths)
        Shares of 1.
    """
    values, vectors = np.linalg.eigh(shared)
    root = vectors * np.sqrt(np.clip(values, 0, None))
    lists = generator(NULL_SEED).standard_normal((UNRELATED, len(shared))) @ root.T
    lengths = np.arange(1, len(shared) + 1)
    return np.array([np.tril(heads[:, order]).sum(axis=1) for order in np.argsort(-lists, axis=1)]) / lengths


def overlap(simulated: pd.DataFrame, measured: pd.DataFrame, shared: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
    """Overlap of the n best simulated and measured features, for every n, as in the paper's overlap figure.

    Parameters
    ----------
    simulated : DataFrame
        Columns feature, stability_percent and discrimination_percent.
    measured : DataFrame
        The same, of one or more draws of equal repeats (`repeats.draws`).
    shared : DataFrame, shape (features, features)
        `shared_variance` of at least the features that both have; others are left out (the measured scores come from 2D
        regions, for which pyradiomics gives no TotalEnergy).
    level : float, optional
        Of the band of unrelated lists.

    Returns
    -------
    DataFrame
        One row per n: n_top, percent (of the common features) and for both kinds overlap_{kind}_percent (of n; mean
        over draws), overlap_{kind}_sd (`repeats.spread`; NaN of one draw), and of lists that are unrelated to the
        measured one, their features being correlated as these are (`unrelated_overlaps`), expected_{kind}_percent
        (mean), lower_{kind}_percent and upper_{kind}_percent (central 95 %). The same in every row: area_{kind}, mean
        over n of the overlap (1 is full agreement), area_{kind}_sd, area_{kind}_expected and area_{kind}_upper (97.5th
        percentile) of unrelated lists, and n_features.

    Raises
    ------
    InputError
        If a table lacks a column or holds scores that are not finite, or they share fewer than two features.
    """
    _check(simulated, "scores of the simulation")
    _check(measured, "measured scores")
    common = [feature for feature in simulated["feature"] if feature in set(measured["feature"])]
    if len(common) < 2:
        raise InputError(f"overlap: the two tables of scores share {len(common)} features")
    simulated = simulated.set_index("feature").loc[common]
    shared = shared.loc[common, common].to_numpy()
    if "draw" not in measured:
        measured = measured.assign(draw=1, repeats=1, of=1)
    lengths = np.arange(1, len(common) + 1)
    result = pd.DataFrame({"n_top": lengths, "percent": 100 * lengths / len(common)})
    areas = {}
    for kind in KINDS:
        column = f"{kind}_percent"
        best = heads(simulated[column])
        drawn = [heads(one.set_index("feature").loc[common, column]) for _, one in measured.groupby("draw")]
        found = np.array([(best * one).sum(axis=1) for one in drawn]) / lengths
        unrelated = unrelated_overlaps(np.mean(drawn, axis=0), shared)
        share = share_drawn(measured)
        lower, upper = np.quantile(unrelated, [(1 - level) / 2, (1 + level) / 2], axis=0)
        result[f"overlap_{kind}_percent"] = 100 * found.mean(axis=0)
        result[f"overlap_{kind}_sd"] = 100 * spread(found, share)
        result[f"expected_{kind}_percent"] = 100 * unrelated.mean(axis=0)
        result[f"lower_{kind}_percent"], result[f"upper_{kind}_percent"] = 100 * lower, 100 * upper
        areas[f"area_{kind}"] = found.mean()
        areas[f"area_{kind}_sd"] = spread(found.mean(axis=1), share)
        areas[f"area_{kind}_expected"] = unrelated.mean()
        areas[f"area_{kind}_upper"] = np.quantile(unrelated.mean(axis=1), (1 + level) / 2)
    return result.assign(**areas, n_features=len(common))


def lengths_above(overlaps: pd.DataFrame, kind: str) -> int:
    """At how many lengths the lists share more than 97.5 % of unrelated ones do. They are strongly dependent."""
    return int((overlaps[f"overlap_{kind}_percent"] > overlaps[f"upper_{kind}_percent"] + 1e-9).sum())


def _check(scores: pd.DataFrame, name: str) -> None:
    columns = [f"{kind}_percent" for kind in KINDS]
    if missing := [column for column in ("feature", *columns) if column not in scores]:
        raise InputError(f"{name}: lacks the column {missing[0]}; make the table again")
    if not np.isfinite(scores[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)).all():
        raise InputError(f"{name}: holds values that are not finite numbers; make the table again")


def beside(simulated: pd.DataFrame, recorded: pd.DataFrame) -> pd.DataFrame:
    """Scores of every feature over simulated groups and over recorded conditions.

    Parameters
    ----------
    simulated : DataFrame
        As `wilcoxon.scores` gives it.
    recorded : DataFrame
        As `repeats.draws` gives it.

    Returns
    -------
    DataFrame
        One row per feature of both, the most stable measured one first: feature, family, and of each kind of score
        *_percent_simulated, *_percent_measured (mean over draws), *_sd_measured (of one draw); repeats (of each
        recorded condition), rank_simulated and rank_measured by stability, 1 the highest.
    """
    columns = [f"{kind}_percent" for kind in KINDS]
    means, spreads = (getattr(recorded.groupby("feature")[columns], of)() for of in ("mean", "std"))
    table = simulated[["feature", "family", *columns]].merge(
        means.reset_index(), on="feature", suffixes=("_simulated", "_measured")
    )
    for kind in KINDS:
        table[f"{kind}_sd_measured"] = table["feature"].map(spreads[f"{kind}_percent"])
    table["repeats"] = int(recorded["repeats"].iloc[0])
    for source in ("simulated", "measured"):
        table[f"rank_{source}"] = table[f"stability_percent_{source}"].rank(method="min", ascending=False).astype(int)
    return table.sort_values(["rank_measured", "feature"], ignore_index=True)
