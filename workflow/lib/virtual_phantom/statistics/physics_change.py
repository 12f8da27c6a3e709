"""Change of the stability of features by physics, with a confidence interval.

The interval of the difference is computed from the intervals of both values (MOVER; Newcombe, Stat. Med. 17, 873, 1998;
Donner and Zou, Stat. Methods Med. Res. 21, 347, 2012). It assumes independent noise and is too wide if all scans share
their random realizations.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from .stability_measures import UNVARYING

VALUES = ("stability_percent", "ci95_low", "ci95_high")


def stability_change(with_physics: pd.DataFrame, without: pd.DataFrame) -> pd.DataFrame:
    """Stability of every feature with and without physics.

    Parameters
    ----------
    with_physics, without : DataFrame
        From `trust.trust_table`, with the same features.

    Returns
    -------
    DataFrame
        One row per feature, values in percent:

        * feature, family
        * without_percent, without_low, without_high, with_percent, with_low, with_high
        * change_percent: with minus without physics; ci95_low, ci95_high: its 95 % interval
        * changed: yes if the interval excludes 0, no if not, undecided without an interval, or "does not
          vary" if either stability is missing
    """
    both = with_physics[["feature", "family", *VALUES]].merge(
        without[["feature", *VALUES]], on="feature", suffixes=("_with", "_without"), validate="one_to_one"
    )
    value, low, high = (both[f"{name}_with"].to_numpy(float) for name in VALUES)
    before, before_low, before_high = (both[f"{name}_without"].to_numpy(float) for name in VALUES)
    change = value - before
    # The interval of the expected stability may exclude the observed value.
    arms = (value - low, high - value, before - before_low, before_high - before)
    below, above, before_below, before_above = (np.maximum(arm, 0.0) for arm in arms)
    least, most = change - np.hypot(below, before_above), change + np.hypot(above, before_below)
    changed = np.where(np.isnan(least), "undecided", np.where((least > 0) | (most < 0), "yes", "no"))
    changed = np.where(np.isnan(change), UNVARYING, changed)
    return pd.DataFrame(
        {
            "feature": both["feature"],
            "family": both["family"],
            "without_percent": before,
            "without_low": before_low,
            "without_high": before_high,
            "with_percent": value,
            "with_low": low,
            "with_high": high,
            "change_percent": change,
            "ci95_low": least,
            "ci95_high": most,
            "changed": changed,
        }
    )
