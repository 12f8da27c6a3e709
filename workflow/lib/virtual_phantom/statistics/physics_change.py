"""How much the stability of features changes by physics, with an interval.

The interval of the difference comes from those of both values (MOVER; Newcombe, Stat. Med. 17, 873, 1998; Donner and
Zou, Stat. Methods Med. Res. 21, 347, 2012), as if their noise were independent. Where draws are common to all scans it
is not; the interval is then too wide.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

VALUES = ("stability_percent", "ci95_low", "ci95_high")


def table(with_physics: pd.DataFrame, without: pd.DataFrame) -> pd.DataFrame:
    """The stability of every feature with physics and without.

    Parameters
    ----------
    with_physics, without : DataFrame
        As `trust.table` gives them, of the same features.

    Returns
    -------
    DataFrame
        One row per feature, in percent where a name says so: feature, family, without_percent, without_low,
        without_high, with_percent, with_low, with_high, change_percent (with less without), ci95_low, ci95_high (its
        95 % interval), changed (yes: the interval does not hold 0; no; undecided: there is no interval).
    """
    both = with_physics[["feature", "family", *VALUES]].merge(
        without[["feature", *VALUES]], on="feature", suffixes=("_with", "_without"), validate="one_to_one"
    )
    value, low, high = (both[f"{name}_with"].to_numpy(float) for name in VALUES)
    before, before_low, before_high = (both[f"{name}_without"].to_numpy(float) for name in VALUES)
    change = value - before
    # An interval of the expected stability can end short of the value that was found.
    reach = [np.maximum(one, 0.0) for one in (value - low, high - value, before - before_low, before_high - before)]
    least, most = change - np.hypot(reach[0], reach[3]), change + np.hypot(reach[1], reach[2])
    changed = np.where(np.isnan(least), "undecided", np.where((least > 0) | (most < 0), "yes", "no"))
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
