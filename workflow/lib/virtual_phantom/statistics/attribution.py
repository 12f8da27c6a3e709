"""Which property of the simulated images explains most of the features that miss a recording.

A variant is the simulation with one property brought to what was measured (`features.variants`). What it removes
of a feature's shift is what that property explains. Properties act together, so the parts need not add up to the whole,
and a variant may also push features away that agreed: those are counted as broken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..base.streams import generator
from ..features.names import EVERY_FAMILY, family
from .comparison import LEVEL, MARGIN_SD, common_rois, in_sd, samples, spread

BASELINE = "baseline"
RESAMPLES = 1000  # of repeats, for intervals: the ends of a 95 % interval are then those of 94 to 96 %


@dataclass(frozen=True)
class Attribution:
    """What `attribute` found.

    Attributes
    ----------
    cells : DataFrame
        One row per variant, ROI and feature: variant, roi, feature, family, shift_baseline and shift_variant (repeat
        SDs of the recording), removed_sd (of |shift|; negative where the variant is farther off), removed_share (1
        where the shift is gone, negative where it grew; missing without a shift) with removed_lower and removed_upper
        (95 %), missed (by the baseline: |shift| over the margin), repaired (missed, and within the margin in the
        variant) and broken (the other way round).
    properties : DataFrame
        One row per family ("all" first) and variant, the best first: family, rank, variant, cells, misses, repaired,
        share_repaired (of the misses) with lower and upper, broken, median_removed_share (over the misses) with
        median_removed_lower and _upper, share_best (of the resamples in which it was ranked first). Without misses
        shares are missing.
    """

    cells: pd.DataFrame
    properties: pd.DataFrame


def attribute(
    variants: Mapping[str, pd.DataFrame],
    recorded: pd.DataFrame,
    features: Sequence[str],
    *,
    baseline: str = BASELINE,
    rois: Sequence[str] | None = None,
    margin_sd: float = MARGIN_SD,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Attribution:
    """How much of the baseline's shifts each variant removes, and which variant repairs most misses.

    Variants are ranked by the share of misses that they repair, then by the median share of shift that they remove.
    Intervals are percentiles (95 %) of a bootstrap over repeats, those of the simulation drawn alike for all variants
    and ROIs, and those of the recording apart. The recording's SD, which is only the unit, and which features the
    baseline missed are held.

    Parameters
    ----------
    variants : mapping of str to DataFrame
        Features by name, among them `baseline`. Variants are of the baseline's own repeats, in the same order, so that
        they share its noise.
    recorded : DataFrame
        As each of the variants: one row per image and ROI with columns roi and `features`.
    baseline : str, optional
        Its name.
    rois : sequence of str, optional
        As in `comparison.compare`.
    margin_sd : float, optional
        Repeat SDs of the recording over which a shift is a miss.
    resamples : int, optional
        Of the bootstrap.
    seed : int, optional
        Of the bootstrap.

    Raises
    ------
    InputError
        If there is no baseline or nothing beside it, ROIs or features lack, numbers of repeats differ between variants,
        an ROI has fewer than two, or values are not finite.
    """
    if baseline not in variants or len(variants) < 2:
        raise InputError(
            f"attribution: variants are {', '.join(map(str, variants)) or 'none'}; "
            f"give {baseline} and at least one more"
        )
    if not margin_sd > 0 or resamples < 1:
        raise InputError(f"attribution: margin_sd {margin_sd} and resamples {resamples} must be positive")
    features = list(features)
    rois = common_rois(variants[baseline], recorded, rois)
    theirs = samples(recorded, features, rois, "recorded features")
    ours = {
        name: samples(table, features, common_rois(table, recorded, rois), f"features of {name}")
        for name, table in variants.items()
    }
    for name, roi in ((name, roi) for name in ours for roi in rois):
        have, wanted = len(ours[name][roi]), len(ours[baseline][roi])
        if have != wanted:
            raise InputError(
                f"features of {name}: {have} images of ROI {roi}, {baseline} has {wanted}; "
                "make all variants of the same repeats"
            )
    unit = np.stack([spread(theirs[roi]) for roi in rois])
    size = np.stack([np.abs(np.concatenate([theirs[roi], ours[baseline][roi]])).max(axis=0) for roi in rois])
    rng = generator(seed)
    measured = _means(theirs, rois, resamples, rng)
    shared = rng.integers(2**63)  # every variant draws the same repeats
    difference = {name: _means(each, rois, resamples, generator(shared)) - measured for name, each in ours.items()}
    shift = {name: np.abs(in_sd(each, unit, size)) for name, each in difference.items()}
    missed = shift[baseline][0] > margin_sd
    others = [name for name in variants if name != baseline]
    with np.errstate(divide="ignore", invalid="ignore"):
        removed = {name: 1 - np.abs(difference[name]) / np.abs(difference[baseline]) for name in others}
    for each in removed.values():
        each[~np.isfinite(each)] = np.nan
    within = {name: shift[name] <= margin_sd for name in others}
    # In a resample the baseline may come within the margin by itself: that is no repair.
    repaired = {name: within[name] & (shift[baseline] > margin_sd) for name in others}
    signed = {name: in_sd(each[0], unit, size) for name, each in difference.items()}
    cells = [
        _cells(name, rois, features, signed[baseline], signed[name], removed[name], missed, within[name][0])
        for name in others
    ]
    families = np.array([family(feature) for feature in features])
    properties = []
    for label in ("all", *(name for name in EVERY_FAMILY.values() if name in families)):
        chosen = np.broadcast_to((families == label) | (label == "all"), missed.shape)
        properties.append(_properties(label, others, chosen, missed, within, repaired, removed))
    return Attribution(pd.concat(cells, ignore_index=True), pd.concat(properties, ignore_index=True))


def _means(repeats: Mapping[str, np.ndarray], rois: Sequence[str], resamples: int, rng) -> np.ndarray:
    """Means over repeats: first as they are, then of repeats drawn with replacement.

    ROIs that have as many images draw the same ones, so that what is common to an image stays together.

    Returns
    -------
    ndarray, shape (1 + resamples, rois, features)
    """
    weights: dict[int, np.ndarray] = {}
    means = []
    for roi in rois:
        n = len(repeats[roi])
        if n not in weights:
            weights[n] = np.vstack([np.ones(n), rng.multinomial(n, np.full(n, 1 / n), size=resamples)]) / n
        # About the first repeat, so that constants stay exactly what they are.
        first = repeats[roi][0]
        means.append(first + weights[n] @ (repeats[roi] - first))
    return np.stack(means, axis=1)


def _cells(variant, rois, features, before, after, removed, missed, within) -> pd.DataFrame:
    lower, upper = _interval(removed[1:].reshape(len(removed) - 1, -1))
    with np.errstate(invalid="ignore"):
        removed_sd = np.abs(before) - np.abs(after)
    return pd.DataFrame(
        {
            "variant": variant,
            "roi": np.repeat(rois, len(features)),
            "feature": features * len(rois),
            "family": [family(feature) for feature in features] * len(rois),
            "shift_baseline": before.ravel(),
            "shift_variant": after.ravel(),
            "removed_sd": removed_sd.ravel(),
            "removed_share": removed[0].ravel(),
            "removed_lower": lower,
            "removed_upper": upper,
            "missed": missed.ravel(),
            "repaired": (missed & within).ravel(),
            "broken": (~missed & ~within).ravel(),
        }
    )


def _properties(label, names, chosen, missed, within, repaired, removed) -> pd.DataFrame:
    misses = chosen & missed
    if misses.any():
        share = np.array([repaired[name][:, misses].mean(axis=1) for name in names])
        median = np.array([np.nanmedian(removed[name][:, misses], axis=1) for name in names])
        # Last key first: by share repaired, then by what is removed; of equal ones, the first.
        order = np.lexsort((-median, -share), axis=0)
        first = np.bincount(order[0, 1:], minlength=len(names)) / (share.shape[1] - 1)
        ranked = order[:, 0]
    else:
        share = median = np.full((len(names), 2), np.nan)
        first, ranked = np.full(len(names), np.nan), np.arange(len(names))
    lower, upper = _interval(share[:, 1:].T)
    median_lower, median_upper = _interval(median[:, 1:].T)
    rows = [
        {
            "family": label,
            "rank": place + 1,
            "variant": names[index],
            "cells": int(chosen.sum()),
            "misses": int(misses.sum()),
            "repaired": int((misses & within[names[index]][0]).sum()),
            "share_repaired": share[index, 0],
            "lower": lower[index],
            "upper": upper[index],
            "broken": int((chosen & ~missed & ~within[names[index]][0]).sum()),
            "median_removed_share": median[index, 0],
            "median_removed_lower": median_lower[index],
            "median_removed_upper": median_upper[index],
            "share_best": first[index],
        }
        for place, index in enumerate(ranked)
    ]
    return pd.DataFrame(rows)


def _interval(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Percentiles over resamples (rows), missing where a resample is."""
    tail = 50 * (1 - LEVEL)
    return tuple(np.percentile(draws, (tail, 100 - tail), axis=0))
