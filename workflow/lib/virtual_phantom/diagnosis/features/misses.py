"""Count the features that differ from a recording, and the features that a changed image property corrects."""

from __future__ import annotations

import numpy as np

from ...features.names import EVERY_FAMILY, family
from .responses import Responses
from .selection import shift


def misses(data: Responses, values: np.ndarray, margin_sd: float) -> dict[str, dict]:
    """Count misses that a property repairs, and agreements that it breaks, by family of features.

    A feature misses the recording in an ROI if the means differ by more than the margin.

    Parameters
    ----------
    values : ndarray, shape (repeats, rois, features)
        Features of the images with the property changed, on regions to which its strength was not fitted.
    margin_sd : float
        Margin in standard deviations over the repeats of the recording.

    Returns
    -------
    dict of str to dict
        {family: counts}, "all" first. Counts: cells (pairs of feature and ROI), misses, repaired, broken, and
        median_removed_share, the median share of the distance that is removed from misses (None without misses).
    """
    before, after = np.abs(shift(data, data.baseline)), np.abs(shift(data, values))
    missed, within = before > margin_sd, after <= margin_sd
    families = np.array([family(feature) for feature in data.features])
    found = {}
    for name in ("all", *(name for name in EVERY_FAMILY.values() if name in families)):
        chosen = np.broadcast_to((families == name) | (name == "all"), missed.shape)
        missed_here = chosen & missed
        found[name] = {
            "cells": int(chosen.sum()),
            "misses": int(missed_here.sum()),
            "repaired": int((missed_here & within).sum()),
            "broken": int((chosen & ~missed & ~within).sum()),
            "median_removed_share": (
                float(np.median(1 - after[missed_here] / before[missed_here])) if missed_here.any() else None
            ),
        }
    return found
