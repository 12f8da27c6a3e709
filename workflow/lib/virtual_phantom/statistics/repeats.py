"""Scores from equal numbers of repeats, by random subsamples of the table that has more repeats.

|W| grows with the square root of the number of repeats, so more repeats lower the stability and raise the
discriminative power.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..base.streams import generator, root
from . import wilcoxon

DRAWS = 30  # subsamples; the relative error of their SD is 13 %, 1 / sqrt(2 (30 - 1))
SEED = 4732  # seed of the subsamples, the same in every study


def shared_units(table: pd.DataFrame, unit: str) -> np.ndarray:
    """Return the sorted values of the column `unit` that all groups (column group) have."""
    return np.array(sorted(set.intersection(*(set(rows[unit]) for _, rows in table.groupby("group")))))


def subsamples(table: pd.DataFrame, repeats: int, unit: str, shared: bool) -> Iterator[tuple[pd.DataFrame, int]]:
    """Draw repeats of every group at random, without replacement: DRAWS times, or once if all are needed.

    Parameters
    ----------
    table : DataFrame
        Columns group and `unit`.
    repeats : int
        Repeats per group.
    unit : str
        Column that identifies the repeats of a group.
    shared : bool
        Whether a value of `unit` is the same acquisition in every group: all groups then get the same values.
        Otherwise each group gets its own draw.

    Yields
    ------
    chosen : DataFrame
        Rows of the drawn repeats.
    available : int
        Number of repeats that they were drawn from.
    """
    units = {group: np.sort(rows[unit].unique()) for group, rows in table.groupby("group")}
    if shared:
        common = shared_units(table, unit)
        units = dict.fromkeys(units, common)
    available = min(map(len, units.values()))
    repeats = min(repeats, available)
    for stream in root(SEED).spawn(DRAWS if repeats < available else 1):
        rng = generator(stream)
        if shared:
            chosen = dict.fromkeys(units, rng.choice(common, repeats, replace=False))
        else:
            chosen = {group: rng.choice(values, repeats, replace=False) for group, values in units.items()}
        keep = np.concatenate([rows.index[rows[unit].isin(chosen[group])] for group, rows in table.groupby("group")])
        yield table.loc[np.sort(keep)], available


def score_draws(
    table: pd.DataFrame, features: Sequence[str], repeats: int, *, unit: str, shared: bool = False, **options
) -> pd.DataFrame:
    """Scores of every feature in every subsample.

    Parameters
    ----------
    repeats, unit, shared
        See `subsamples`.
    **options
        Options of `wilcoxon.scores`.

    Returns
    -------
    DataFrame
        One row per draw and feature: repeats, of (number of repeats drawn from), draw (1, 2, ...), and the columns of
        `wilcoxon.scores`.

    Raises
    ------
    InputError
        For fewer than two groups or tissue classes, and as `wilcoxon.scores`.
    """
    for kind, column in (("group", "group"), ("tissue class", "tissue_class")):
        if (number := table[column].nunique()) < 2:
            source = options.get("source", "features")
            raise InputError(f"{source}: {number} {kind}; stability and discrimination need at least two")
    draws = []
    for draw, (chosen, available) in enumerate(subsamples(table, repeats, unit, shared), 1):
        scores = wilcoxon.scores(chosen, features, **options)
        scores.insert(0, "repeats", min(repeats, available))
        scores.insert(1, "of", available)
        scores.insert(2, "draw", draw)
        draws.append(scores)
    return pd.concat(draws, ignore_index=True)


def sampling_fraction(scores: pd.DataFrame) -> float:
    """Fraction of the available repeats in each of the `score_draws`."""
    return float(scores["repeats"].iloc[0] / scores["of"].iloc[0])


def sd_of_draws(values: np.ndarray, fraction: float) -> np.ndarray:
    """SD over new samples of equal size, from the SD over draws with a finite population correction.

    Draws of n from N repeats overlap, so their SD is the SD of n new repeats times sqrt(1 - n / N). This is exact for
    means [1]_.

    Parameters
    ----------
    values : ndarray, shape (draws, ...)
    fraction : float
        n / N, from `sampling_fraction`.

    Returns
    -------
    ndarray, shape (...)
        NaN for a single draw.

    References
    ----------
    .. [1] Cochran, Sampling Techniques, 3rd edition, 1977, theorem 2.2.
    """
    if len(values) < 2:
        return np.full(np.shape(values)[1:], np.nan)
    return np.std(values, axis=0, ddof=1) / np.sqrt(1 - fraction)


def mean_over_features(scores: pd.DataFrame, kind: str) -> tuple[float, float]:
    """Mean over features of a kind of score, and the SD of this mean over draws (`sd_of_draws`)."""
    means = scores.groupby("draw")[f"{kind}_percent"].mean().to_numpy()
    return float(means.mean()), float(sd_of_draws(means, sampling_fraction(scores)))
