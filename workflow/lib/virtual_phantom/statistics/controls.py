"""Controls of the mean stability and discriminative power: pairs of one tissue class, noise alone, and chance.

Two ROIs differ in size, position and texture even if they are of one tissue class. If pairs of one class differ as
often as pairs of different classes, W distinguishes ROIs and not tissues. Chance gives the scores if nothing differs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from .rank_sum import differing_probability, stable_probability
from .wilcoxon import Comparisons, comparisons

DIFFERENT_CLASSES, SAME_CLASS, PROTOCOLS, CHANCE = "different classes", "same class", "protocols", "chance"
WHITE_NOISE = "white noise"
IN_WORDS = {SAME_CLASS: "pairs of one tissue class", WHITE_NOISE: "noise without a scan", CHANCE: "by chance"}
NO_CONTROL = "no control of one tissue class"
ONE_ROI_PER_CLASS = "Not possible: no tissue class has two ROIs."
POOLED = "Not possible: statistics.compare pools the ROIs of a class."
ONE_CLASS = "Not possible: all ROIs are of one tissue class."
ONE_PROTOCOL = "Not possible: the study has one protocol."


def controls(
    table: pd.DataFrame,
    features: Sequence[str],
    *,
    threshold: float = 1.0,
    compare: str = "roi",
    **options,
) -> pd.DataFrame:
    """Compute the mean scores of a study and their controls.

    Parameters
    ----------
    table, features, threshold, compare, **options
        As for `wilcoxon.scores`. Features that do not vary are not counted.

    Returns
    -------
    DataFrame
        One row per score and control:

        * score: stability (share of comparisons with |W| below the threshold) or discrimination (above it)
        * control: protocols and different classes (the scores of the study), same class, chance
        * percent: 100 times count / comparisons; NaN for a score or control that is not possible. For chance, the exact
          probability for continuous values and independent samples.
        * count, comparisons: over all features; NaN for chance
        * pairs: pairs of groups in each ROI (stability), or pairs of ROIs in each group (discrimination)
        * features: number of features
        * repeats: values in the smallest sample
        * meaning: the row in words
    """
    found = comparisons(table, features, threshold=threshold, compare=compare, **options)
    groups, across, within = len(found.groups), found.pairs(same_class=False), found.pairs(same_class=True)
    stable = np.concatenate(list(found.stable.values()))
    equal = np.mean([stable_probability(size, threshold) for size in found.sizes.values()])
    probabilities = [differing_probability(found.sizes[a], found.sizes[b], threshold) for a, b in across]
    differing = np.mean(probabilities) if across else np.nan
    impossible = ONE_ROI_PER_CLASS if compare == "roi" else POOLED
    rows = [
        ("stability", PROTOCOLS, *_share(found, [stable]), groups * (groups - 1) // 2)
        + (f"Pairs of protocols with |W| < {threshold:g}, for the same ROI." if groups > 1 else ONE_PROTOCOL,),
        ("stability", CHANCE, 100 * equal, np.nan, np.nan, np.nan)
        + (f"Probability of |W| < {threshold:g} if no protocol changes the feature.",),
        ("discrimination", DIFFERENT_CLASSES, *_share(found, [found.differing[pair] for pair in across]), len(across))
        + (
            f"Pairs of ROIs of different tissue classes with |W| > {threshold:g}, for the same protocol."
            if across
            else ONE_CLASS,
        ),
        ("discrimination", SAME_CLASS, *_share(found, [found.differing[pair] for pair in within]), len(within))
        + (f"Pairs of ROIs of one tissue class with |W| > {threshold:g}." if within else impossible,),
        ("discrimination", CHANCE, 100 * differing, np.nan, np.nan, np.nan)
        + (f"Probability of |W| > {threshold:g} if the ROIs do not differ." if across else ONE_CLASS,),
    ]
    columns = ["score", "control", "percent", "count", "comparisons", "pairs", "meaning"]
    result = pd.DataFrame(rows, columns=columns).astype(dict.fromkeys(columns[3:6], "Int64"))
    result.insert(6, "features", int(found.varies.sum()))
    result.insert(7, "repeats", min(found.sizes.values()))
    return result


def add_noise_control(
    found: pd.DataFrame, noise_only: pd.DataFrame, features: Sequence[str], **options
) -> pd.DataFrame:
    """Append the scores of the phantom with white noise instead of scans to a table of `controls`.

    Parameters
    ----------
    noise_only : DataFrame
        Features, with columns as for `controls`: the noise has the variance of each protocol and ROI.
    """
    alone = controls(noise_only, features, **options)
    alone = alone[alone["control"].isin([PROTOCOLS, DIFFERENT_CLASSES])]
    meaning = "The same for the phantom without a scan, with white noise of the variance of each protocol and ROI."
    return pd.concat([found, alone.assign(control=WHITE_NOISE, meaning=meaning)], ignore_index=True)


def _share(found: Comparisons, results: Sequence[np.ndarray]) -> tuple[float, int, int]:
    """Percentage, number of successes and number of comparisons over all features that vary."""
    chosen = [result[:, found.varies] for result in results]
    count, total = sum(int(result.sum()) for result in chosen), sum(result.size for result in chosen)
    return (100 * count / total if total else np.nan), count, total


def headline(table: pd.DataFrame, sd: Mapping[str, float] | None = None) -> dict[str, str]:
    """Describe the mean scores with their controls, as shown on pages and in figures.

    Parameters
    ----------
    table : DataFrame
        From `controls`. Rows may be missing.
    sd : mapping of str to float, optional
        {score: standard deviation of the mean score}.

    Returns
    -------
    dict of str to str
        {score: text}, such as "92.4 % (pairs of one tissue class: 89.0 %; by chance: 31.5 %)".
    """
    percent = {(row.score, row.control): row.percent for row in table.itertuples()}
    texts = {}
    for score, mean in (("stability", PROTOCOLS), ("discrimination", DIFFERENT_CLASSES)):
        if (score, mean) not in percent:
            continue
        if np.isnan(percent[score, mean]):
            texts[score] = "not possible"
            continue
        spread = f" ± {sd[score]:.1f}" if sd else ""
        found = {name: percent[score, name] for name in IN_WORDS if (score, name) in percent}
        words = [NO_CONTROL if np.isnan(value) else f"{IN_WORDS[name]}: {value:.1f} %" for name, value in found.items()]
        texts[score] = f"{percent[score, mean]:.1f}{spread} %" + (f" ({'; '.join(words)})" if words else "")
    return texts
