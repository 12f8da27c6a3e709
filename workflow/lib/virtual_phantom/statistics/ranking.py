"""The highest-scoring features, and the agreement of two rankings.

Scores are fractions of a few dozen comparisons, so many features tie. Printed lists order ties as in names.FEATURES and
mark them. Comparisons of lists treat the order within a tie as random.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..base.streams import generator
from .agreement_measures import CONFIDENCE
from .repeats import sampling_fraction, sd_of_draws

KINDS = ("stability", "discrimination")
RANDOM_LISTS = 2000  # the limits of a 95 % band then enclose 94 to 96 %
NULL_SEED = 86  # seed of the random lists, the same in every study


def top_features(
    scores: pd.DataFrame, published: pd.DataFrame | None = None, measured: pd.DataFrame | None = None
) -> pd.DataFrame:
    """The ten most stable and most discriminative features, with the measured and published ones.

    Parameters
    ----------
    scores : DataFrame
        From `wilcoxon.scores`.
    published : DataFrame, optional
        Columns kind, rank, source (simulator | phantom), feature.
    measured : DataFrame, optional
        From `repeats.score_draws`; features are ranked by their mean over draws.

    Returns
    -------
    DataFrame
        One row per rank. Columns for both kinds of score:

        * {kind}_simulated, {kind}_simulated_percent
        * {kind}_simulated_tied: number of features with the same score. If it is larger than one, the order of names
          decides rank and membership.
        * with `measured`: {kind}_measured, {kind}_measured_percent, {kind}_measured_sd
        * with `published`: {kind}_published_simulator, {kind}_published_phantom

    Raises
    ------
    InputError
        If scores lack a column or are not finite.
    """
    _check(scores, "simulated scores")
    if measured is not None:
        _check(measured, "measured scores")
    n = min(10, len(scores))
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
            columns[f"{kind}_measured_sd"] = sd_of_draws(drawn[best].to_numpy(), sampling_fraction(measured))
        for source in ("simulator", "phantom") if published is not None else ():
            chosen = (published["kind"] == kind) & (published["source"] == source)
            column = published[chosen].set_index("rank")
            columns[f"{kind}_published_{source}"] = column["feature"].reindex(columns["rank"]).to_numpy()
    return pd.DataFrame(columns)


def assessed(scores: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the rows of features with scores, without features that do not vary (in one draw or more).

    Raises
    ------
    InputError
        If no feature has scores.
    """
    columns = [f"{kind}_percent" for kind in KINDS]
    empty = scores.loc[scores[columns].isna().all(axis=1), "feature"]
    if scores["feature"].isin(empty).all():
        raise InputError(f"{name}: no feature varies over repeats; add features of the image values to extraction")
    return scores[~scores["feature"].isin(empty)].reset_index(drop=True)


def membership(scores: np.ndarray, n: int) -> np.ndarray:
    """Probability that each item is among the n highest scores, with ties broken at random.

    1 above the n-th highest score, 0 below it. Items with exactly that score share the remaining ranks equally.
    """
    scores = np.asarray(scores, dtype=np.float64)
    cut = np.sort(scores)[-n]
    above, tied = scores > cut, scores == cut
    return above + tied * (n - above.sum()) / tied.sum()


def memberships(scores: np.ndarray) -> np.ndarray:
    """Return `membership` for every n, shape (lengths, items)."""
    return np.array([membership(scores, n) for n in range(1, len(scores) + 1)])


def shared_variance(table: pd.DataFrame, features: Sequence[str]) -> pd.DataFrame:
    """Squared Spearman correlation between features over the rows of an ROI, averaged over ROIs.

    A feature that does not vary in an ROI has a correlation of 0 there.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns roi and `features`, finite.

    Returns
    -------
    DataFrame, shape (features, features)
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


def random_overlaps(given: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Overlap of RANDOM_LISTS random lists with a given list, as a fraction of every length.

    Correlated features have similar ranks by chance. The scores of a random list are therefore drawn from a normal
    distribution whose correlations are the squared correlations of the features. W gives such scores for groups that do
    not differ. In the measured table with permuted groups, the correlation of two scores is 0.95 times that square
    (r = 0.95 over pairs of features; tests/statistics/test_statistics_ranking.py).

    Parameters
    ----------
    given : ndarray, shape (lengths, items)
        `memberships` of the given list.
    shared : ndarray, shape (items, items)
        Covariance of the items' scores in a random list: `shared_variance`.

    Returns
    -------
    ndarray, shape (lists, lengths)
    """
    values, vectors = np.linalg.eigh(shared)
    root = vectors * np.sqrt(np.clip(values, 0, None))
    lists = generator(NULL_SEED).standard_normal((RANDOM_LISTS, len(shared))) @ root.T
    lengths = np.arange(1, len(shared) + 1)
    return np.array([np.tril(given[:, order]).sum(axis=1) for order in np.argsort(-lists, axis=1)]) / lengths


def overlap(simulated: pd.DataFrame, measured: pd.DataFrame, shared: pd.DataFrame) -> pd.DataFrame:
    """Overlap of the n best simulated and measured features, for every n (figure 5 of Flouris et al., 2022).

    Parameters
    ----------
    simulated : DataFrame
        Columns feature, stability_percent, discrimination_percent.
    measured : DataFrame
        The same columns, from one or more draws (`repeats.score_draws`).
    shared : DataFrame, shape (features, features)
        `shared_variance` of at least the features that both tables have. Other features are ignored.

    Returns
    -------
    DataFrame
        One row per n:

        * n_top, percent: n, and n relative to the number of common features
        * overlap_{kind}_percent: features in both lists, relative to n; mean over draws
        * overlap_{kind}_sd: from `repeats.sd_of_draws`; NaN for one draw
        * expected_{kind}_percent, lower_{kind}_percent, upper_{kind}_percent: mean and central 95 % of random lists of
          equally correlated features (`random_overlaps`)

        The same in every row: n_features, area_{kind} (mean over n of the overlap; 1 is full agreement),
        area_{kind}_sd, area_{kind}_expected and area_{kind}_upper (mean and 97.5th percentile of random lists).

    Raises
    ------
    InputError
        If a table lacks a column or has scores that are not finite, or fewer than two features are in both.
    """
    _check(simulated, "simulated scores")
    _check(measured, "measured scores")
    common = [feature for feature in simulated["feature"] if feature in set(measured["feature"])]
    if len(common) < 2:
        raise InputError(
            f"overlap: the two tables of scores share {len(common)} features; use the same feature names in both"
        )
    simulated = simulated.set_index("feature").loc[common]
    shared = shared.loc[common, common].to_numpy()
    if "draw" not in measured:
        measured = measured.assign(draw=1, repeats=1, of=1)
    lengths = np.arange(1, len(common) + 1)
    result = pd.DataFrame({"n_top": lengths, "percent": 100 * lengths / len(common)})
    areas = {}
    for kind in KINDS:
        column = f"{kind}_percent"
        best = memberships(simulated[column])
        draws = [memberships(draw.set_index("feature").loc[common, column]) for _, draw in measured.groupby("draw")]
        overlaps = np.array([(best * draw).sum(axis=1) for draw in draws]) / lengths
        random = random_overlaps(np.mean(draws, axis=0), shared)
        fraction = sampling_fraction(measured)
        lower, upper = np.quantile(random, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
        result[f"overlap_{kind}_percent"] = 100 * overlaps.mean(axis=0)
        result[f"overlap_{kind}_sd"] = 100 * sd_of_draws(overlaps, fraction)
        result[f"expected_{kind}_percent"] = 100 * random.mean(axis=0)
        result[f"lower_{kind}_percent"], result[f"upper_{kind}_percent"] = 100 * lower, 100 * upper
        areas[f"area_{kind}"] = overlaps.mean()
        areas[f"area_{kind}_sd"] = sd_of_draws(overlaps.mean(axis=1), fraction)
        areas[f"area_{kind}_expected"] = random.mean()
        areas[f"area_{kind}_upper"] = np.quantile(random.mean(axis=1), (1 + CONFIDENCE) / 2)
    return result.assign(**areas, n_features=len(common))


def lengths_above(overlaps: pd.DataFrame, kind: str) -> int:
    """Number of list lengths at which the overlap exceeds the 97.5th percentile of random lists."""
    return int((overlaps[f"overlap_{kind}_percent"] > overlaps[f"upper_{kind}_percent"] + 1e-9).sum())


def _check(scores: pd.DataFrame, name: str) -> None:
    columns = [f"{kind}_percent" for kind in KINDS]
    if missing := [column for column in ("feature", *columns) if column not in scores]:
        raise InputError(f"{name}: lacks the column {missing[0]}; make the table again")
    if not np.isfinite(scores[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)).all():
        raise InputError(f"{name}: has values that are not finite numbers; make the table again")


def compare_scores(simulated: pd.DataFrame, recorded: pd.DataFrame) -> pd.DataFrame:
    """Simulated and recorded scores of every feature that both tables score, most stable recorded feature first.

    Parameters
    ----------
    simulated : DataFrame
        From `wilcoxon.scores`.
    recorded : DataFrame
        From `repeats.score_draws`.

    Returns
    -------
    DataFrame
        Columns:

        * feature, family
        * for each kind of score *_percent_simulated, *_percent_measured (mean over draws), *_sd_measured (of one draw)
        * repeats of each recorded condition
        * rank_simulated, rank_measured: by stability; 1 is the highest
    """
    columns = [f"{kind}_percent" for kind in KINDS]
    simulated, recorded = assessed(simulated, "simulated scores"), assessed(recorded, "recorded scores")
    scores = recorded.groupby("feature")[columns]
    means, sds = scores.mean(), scores.std()
    table = simulated[["feature", "family", *columns]].merge(
        means.reset_index(), on="feature", suffixes=("_simulated", "_measured")
    )
    for kind in KINDS:
        table[f"{kind}_sd_measured"] = table["feature"].map(sds[f"{kind}_percent"])
    table["repeats"] = int(recorded["repeats"].iloc[0])
    for source in ("simulated", "measured"):
        table[f"rank_{source}"] = table[f"stability_percent_{source}"].rank(method="min", ascending=False).astype(int)
    return table.sort_values(["rank_measured", "feature"], ignore_index=True)
