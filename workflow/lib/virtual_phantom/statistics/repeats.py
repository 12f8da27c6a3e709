"""Scores at equal numbers of repeats: random subsamples of a table that has more of them than it is compared with.

|W| grows with the root of the number of repeats, so that more of them lower stability and raise discriminative power.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from ..base.streams import generator, root
from . import wilcoxon

DRAWS = 30  # subsamples: their SD is known to 13 %, 1 / sqrt(2 (30 - 1))
SEED = 4732  # of the stream of subsamples, the same in every study


def subsamples(table: pd.DataFrame, repeats: int, unit: str, shared: bool) -> Iterator[tuple[pd.DataFrame, int]]:
    """Choose repeats of every group at random, without replacement: DRAWS times, or once if they are no more.

    Parameters
    ----------
    table : DataFrame
        Rows with columns group and `unit`.
    repeats : int
        Of every group.
    unit : str
        Column that tells the repeats of a group apart.
    shared : bool
        Whether a value of `unit` is the same acquisition in every group, and is then chosen in all or in none;
        otherwise each group has a choice of its own, of as many as the smallest group has.

    Yields
    ------
    chosen : DataFrame
        Rows of the repeats chosen.
    of : int
        How many they are chosen of.
    """
    of_group = {group: np.sort(rows[unit].unique()) for group, rows in table.groupby("group")}
    if shared:
        common = np.array(sorted(set.intersection(*map(set, of_group.values()))))
        of_group = dict.fromkeys(of_group, common)
    of = min(map(len, of_group.values()))
    repeats = min(repeats, of)
    for stream in root(SEED).spawn(DRAWS if repeats < of else 1):
        rng = generator(stream)
        one = rng.choice(common, repeats, replace=False) if shared else None
        chosen = {g: one if shared else rng.choice(units, repeats, replace=False) for g, units in of_group.items()}
        keep = np.concatenate([rows.index[rows[unit].isin(chosen[group])] for group, rows in table.groupby("group")])
        yield table.loc[np.sort(keep)], of


def draws(
    table: pd.DataFrame, features: Sequence[str], repeats: int, *, unit: str, shared: bool = False, **options
) -> pd.DataFrame:
    """Scores of every feature in every subsample.

    Parameters
    ----------
    repeats, unit, shared
        As `subsamples` takes them.
    **options
        Of `wilcoxon.scores`, which says what it raises.

    Returns
    -------
    DataFrame
        One row per draw and feature: repeats, of (how many they were drawn from), draw (1, 2, ...), and the columns of
        `wilcoxon.scores`.
    """
    found = []
    for draw, (chosen, of) in enumerate(subsamples(table, repeats, unit, shared), 1):
        scores = wilcoxon.scores(chosen, features, **options)
        scores.insert(0, "repeats", min(repeats, of))
        scores.insert(1, "of", of)
        scores.insert(2, "draw", draw)
        found.append(scores)
    return pd.concat(found, ignore_index=True)


def share_drawn(scores: pd.DataFrame) -> float:
    """The share of the repeats that each of the `draws` took."""
    return float(scores["repeats"].iloc[0] / scores["of"].iloc[0])


def spread(values: np.ndarray, share: float) -> np.ndarray:
    """SD over draws that as many repeats taken again would have.

    Parameters
    ----------
    values : ndarray, shape (draws, ...)
    share : float
        `share_drawn`: subsamples of n of N repeats overlap, so that their SD is that of n new ones times sqrt(1 - n /
        N), exactly so for means [1]_.

    Returns
    -------
    ndarray, shape (...)
        NaN of a single draw.

    References
    ----------
    .. [1] Cochran, Sampling Techniques, 3rd edition, 1977, theorem 2.2.
    """
    if len(values) < 2:
        return np.full(np.shape(values)[1:], np.nan)
    return np.std(values, axis=0, ddof=1) / np.sqrt(1 - share)


def over_features(scores: pd.DataFrame, kind: str) -> tuple[float, float]:
    """Mean over features of a kind of score, and its SD over draws (`spread`)."""
    means = scores.groupby("draw")[f"{kind}_percent"].mean().to_numpy()
    return float(means.mean()), float(spread(means, share_drawn(scores)))
