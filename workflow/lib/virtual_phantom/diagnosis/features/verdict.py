"""Verdict of a diagnosis of features: best image property, remaining mismatch, and the next measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ...base.names import label
from ...base.streams import generator
from ...features.names import EVERY_FAMILY, MEAN, family
from ...statistics.comparison import MARGIN_SD
from ..verdict_text import feature_lines, verdict_of, with_verdict_text
from .properties import FOLDS, Property, calibration
from .residuals import FeatureLocation, FeatureLocations, compare_features
from .responses import Responses, finer, removed
from .selection import MATERIAL, Trial, alternatives, shift, trials

RESAMPLES = 200  # bootstrap samples; the coverage of a 95 % interval is then 92 to 98 %
TAIL = 2.5  # % on either side of an interval
FINER_DATA = (
    "images of the same scans, which show edges and noise power",
    "projections of the same scans, which distinguish effects before the reconstruction",
)


@dataclass(frozen=True)
class FeatureDiagnosis:
    """Result of a diagnosis of features.

    Attributes
    ----------
    before, after : FeatureLocations
        Mismatch on held-out regions, without and with the best property.
    """

    before: FeatureLocations
    after: FeatureLocations
    trials: dict[Property, Trial]
    content: dict


def diagnose_features(
    name: str, data: Responses, not_compared: Mapping[str, str], margin_sd: float = MARGIN_SD
) -> FeatureDiagnosis:
    """Find the image property that explains the difference of features.

    Parameters
    ----------
    not_compared : mapping of str to str
        {feature: reason}.
    margin_sd : float, optional
        Largest difference of means that counts as agreement, in SDs over repeats of the recording.
    """
    before, found = compare_features(data, data.baseline), trials(data)
    best, trial = next(iter(found.items()))
    differ = bool(before.significant)
    chosen = differ and trial.is_explanation
    after = compare_features(data, trial.held_out_features) if chosen else before
    left = after.significant
    rivals = [rival.name for rival in alternatives(found)] if chosen else []
    effect = {
        "name": best.name,
        "physics": best.physics,
        "parameters": _parameters(data, best) if chosen else {},
        "evidence": {"held_out_gain": trial.held_out, "p": trial.p},
    }
    content = {
        "recording": name,
        "verdict": verdict_of(chosen, bool(left)),
        "locations": [_content(location) for location in before.significant],
        "effects": [effect] if chosen else [],
        "ambiguous_with": {best.name: rivals} if chosen else {},
        "ruled_out": {
            tested.name: test.held_out for tested, test in found.items() if differ and test.held_out < MATERIAL
        },
        "fit": _metrics(data, trial if chosen else None, held_out=False),
        "held_out": _metrics(data, trial if chosen else None, held_out=True),
        "excess_removed": trial.held_out if chosen else None,
        "unexplained": [_content(location) for location in left],
        "next_measurement": _next(best, rivals, found, bool(left)),
        "held_out_data": "regions: each half judged by strengths fitted on the other",
        "candidates": {
            tested.name: {
                "fitted": test.fitted,
                "held_out": test.held_out,
                "p": test.p,
                "strengths": {str(fold): value for fold, value in test.strengths.items()},
                "regions": dict(zip(data.rois, test.regions.tolist(), strict=True)),
                "families": misses(data, test.held_out_features, margin_sd),
            }
            for tested, test in found.items()
        },
        "not_compared": dict(not_compared),
        "axes": {"features": data.features, "regions": data.rois},
    }
    return FeatureDiagnosis(before, after, found, with_verdict_text(content, feature_lines(content)))


def overlay(data: Responses, content: dict) -> dict:
    """Return the effect as a configuration of the study; empty if the property is no effect or has no values."""
    known = {tested.name for tested in data.curves if tested.is_effect}
    physics = {
        effect["name"]: {key: parameter["value"] for key, parameter in effect["parameters"].items()}
        for effect in content["effects"]
        if effect["name"] in known and effect["parameters"]
    }
    return {"physics": physics, "noise": {"model": "physical"}} if physics else {"physics": {}}


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


def _content(location: FeatureLocation) -> dict:
    return {
        "domain": location.domain,
        "where": location.where,
        "z": location.z,
        "p": location.p,
        "map": f"{location.domain}.npy",
        "feature": location.feature,
        "differing": location.differing,
        "features": location.features,
    }


def _parameters(data: Responses, chosen: Property) -> dict:
    """Return strengths fitted on all regions, with 95 % bootstrap intervals over regions and repeats.

    The result is empty without a strength, and for a HU calibration of recordings whose mean HU are not compared.
    """
    tried: dict[str, list[float]] = {}
    if chosen.name == "hu_calibration" and MEAN in data.features:
        units, fit = {"scale": "1", "offset_hu": "HU"}, _calibrated(data)
    elif chosen.parameter is not None:
        units, fit = dict([chosen.parameter]), _strength(data, chosen)
        tried[chosen.parameter[0]] = data.curves[chosen][FOLDS[0]].strengths[[0, -1]].tolist()
    else:
        return {}
    # ROIs, simulated repeats, and recorded repeats of each ROI.
    rng, counts = generator(0), [len(data.rois), len(data.baseline), *map(len, data.recorded)]
    value = fit(*map(np.arange, counts))
    spread = [fit(*(rng.integers(count, size=count) for count in counts)) for _ in range(RESAMPLES)]
    return {
        key: {
            "value": value[key],
            "ci95": [float(np.percentile([draw[key] for draw in spread], q)) for q in (TAIL, 100 - TAIL)],
            "unit": unit,
            "tried": tried.get(key),
        }
        for key, unit in units.items()
    }


def _calibrated(data: Responses):
    """Return the HU calibration as a function of the indices of ROIs, simulated and recorded repeats."""
    column = data.features.index(MEAN)

    def fit(rois, simulated, *recorded):
        pairs = zip(data.recorded, recorded, strict=True)
        recorded_hu = np.array([repeats[rows, column].mean() for repeats, rows in pairs])
        return calibration(data.baseline[simulated][..., column].mean(axis=0)[rois], recorded_hu[rois])

    return fit


def _strength(data: Responses, chosen: Property):
    """Return the strength that removes most, as a function of the indices of ROIs, simulated and recorded repeats."""
    curve = finer(chosen, data.curves[chosen][FOLDS[0]])  # a property with a strength is the same in all folds

    def fit(rois, simulated, *recorded):
        center = np.stack([repeats[rows].mean(axis=0) for repeats, rows in zip(data.recorded, recorded, strict=True)])
        after = (curve.values[:, simulated].mean(axis=1) - center) / data.unit
        before = (data.baseline[simulated].mean(axis=0) - center) / data.unit
        gains = removed(before[rois], after[:, rois], data.floor[rois]).sum(axis=(1, 2))
        return {chosen.parameter[0]: float(curve.strengths[np.argmax(gains)])}

    return fit


def _metrics(data: Responses, trial: Trial | None, held_out: bool) -> dict:
    """Return squared and absolute standardized shifts of the means: before, after, and for noise alone."""
    before = shift(data, data.baseline)
    after = before if trial is None else shift(data, trial.held_out_features if held_out else trial.fitted_features)
    half = stats.norm.ppf(0.75)  # median of |x| of a standard normal distribution
    shifts = {"before": before, "after": after}
    squares = {name: float((values**2).mean()) for name, values in shifts.items()}
    medians = {name: float(np.median(np.abs(values))) for name, values in shifts.items()}
    return {
        "mean_squared_shift": squares | {"floor": float(data.floor.mean())},
        "median_absolute_shift": medians | {"floor": float(half * np.sqrt(np.median(data.floor)))},
    }


def _next(best: Property, rivals: list[str], found: Mapping[Property, Trial], left: bool) -> list[str]:
    by_name = {tested.name: tested for tested in found}
    tests = [
        f"to distinguish {label(best.name)} from {label(rival)}, {by_name[tested].settled_by}"
        for rival in rivals
        for tested in (best.name, rival)
    ]
    return list(dict.fromkeys(tests)) + (list(FINER_DATA) if left else [])
