"""Differences in images and their clinical relevance: HU, contrast, noise, resolution and features.

A difference of projections may be significant and yet too small to be visible in an image. The verdict therefore uses
thresholds on image quantities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from ...base.errors import InputError
from ...statistics.comparison import ALPHA, in_sd, spread
from ...statistics.image_quality import contrast, independent_values, noise_magnitude
from ...statistics.multiplicity import holm
from ...statistics.resolution import mtf_half
from ..fitting.fit import Fit
from ..selection.forward_selection import Choice
from ..verdict_text import DIFFERENCES, MATCH, PRACTICAL, UNEXPLAINED, contradiction
from .agreement import Features, Regions, agreement

# Side of the squares whose mean HU is compared; it is also the smallest side of the tiles for noise spectra.
BLOCK_VOXELS = 8
# Height of the band of rows of an image profile, relative to the object: it averages noise, but stays near the center,
# where cupping is largest. For figures only.
PROFILE_BAND = 0.1


@dataclass(frozen=True)
class ImageChange:
    """Change of one quantity between two sets of images.

    Attributes
    ----------
    value : float
        In the unit of verdict_text.DIFFERENCES.
    error : float
        Standard error from image noise. For the largest of many areas it includes a correction for their number.
    """

    value: float
    error: float

    @property
    def least(self) -> float:
        """Absolute value minus two standard errors, at least 0."""
        return max(0.0, abs(self.value) - 2 * self.error)


def image_changes(
    reference: np.ndarray,
    images: np.ndarray,
    regions: Regions,
    independent: float,
    features: Features | None = None,
    paired: bool = False,
) -> dict[str, ImageChange]:
    """Return the change of each quantity from reference images to other images.

    Parameters
    ----------
    reference, images : ndarray, shape (repeats, z, y, x)
        HU.
    independent : float
        Independent values of the noise inside the object (image_quality.independent_values).
    features : Features, optional
        None: features are not compared.
    paired : bool, optional
        Whether both sets have the same noise. Errors then come from the spread of their differences; errors
        of percentages are 0.

    Returns
    -------
    dict of str to ImageChange
        By quantity of verdict_text.DIFFERENCES, if it can be measured: noise needs two repeats, contrast two ROIs.
    """
    measures: dict[str, Callable[[], ImageChange]] = {
        "hu": lambda: _hu(reference, images, regions, independent, paired),
        "contrast_percent": lambda: _percent(reference, images, lambda x: contrast(x, regions.rois), paired),
        "noise_percent": lambda: _percent(
            reference, images, lambda x: noise_magnitude(x, regions.inner, independent), paired
        ),
        "resolution_percent": lambda: _percent(
            reference, images, lambda x: mtf_half(x, regions.distance_mm, regions.spacing, regions.valid), paired
        ),
    }
    if features is not None:
        measures["features_sd"] = lambda: _shift(features.of(reference, "without"), features.of(images, "with"), paired)
    found = {}
    for name, measure in measures.items():
        try:
            found[name] = measure()
        except InputError:
            continue
    return found


def agreement_and_changes(
    recorded: np.ndarray,
    images: Callable[[Fit], np.ndarray],
    noise: np.ndarray | None,
    choice: Choice,
    regions: Regions,
    features: Features | None,
    with_changes: bool,
) -> dict:
    """Return the agreement of fitted models with recorded images, and the change that each effect makes.

    Parameters
    ----------
    recorded : ndarray, shape (repeats, z, y, x)
        HU.
    images : callable
        Simulated images of a fit, all with the same noise.
    noise : ndarray, shape (repeats, z, y, x), or None
        Simulated images with independent noise, for its correlation; None: images of the chosen fit are used.
    with_changes : bool
        Whether `practice` is part of the result (`changes_by_effect`).

    Returns
    -------
    dict
        Result of agreement.agreement with rois (names), repeats (number), grid, profile (x_mm, and mean HU of the
        images that are recorded, before and after the diagnosis) and `practice`.
    """
    simulated = {"before": images(choice.baseline.fit), "after": images(choice.chosen.fit)}
    independent = independent_values(simulated["after"] if noise is None else noise, regions.inner)
    found = agreement(recorded, simulated, regions, independent, features=features)
    if with_changes:
        found["practice"] = changes_by_effect(recorded, simulated, images, choice, regions, independent, features)
    profiles = {name: middle_profile(stack, regions) for name, stack in {"recorded": recorded, **simulated}.items()}
    if len(profiles["recorded"][0]):
        found["profile"] = {"x_mm": profiles["recorded"][0].tolist()}
        found["profile"] |= {name: values.tolist() for name, (_, values) in profiles.items()}
    grid = {"shape": list(recorded.shape[1:]), "spacing_mm": list(regions.spacing)}
    return found | {"rois": list(regions.rois), "repeats": len(recorded), "grid": grid}


def middle_profile(images: np.ndarray, regions: Regions) -> tuple[np.ndarray, np.ndarray]:
    """Return the profile along x through the middle of the object, away from its edge.

    It is the mean over repeats, slices and the rows around the middle (PROFILE_BAND of the height of the object).

    Returns
    -------
    x_mm, hu : ndarray, shape (columns,)
        Position from the center of the image, and mean HU; empty if the object has no inner region.
    """
    inner = regions.inner
    rows = np.flatnonzero(inner.any(axis=(0, 2)))
    if not rows.size:
        return np.empty(0), np.empty(0)
    middle, half = rows.mean(), max(PROFILE_BAND * rows.size / 2, 0.5)
    band = [row for row in rows if abs(row - middle) <= half]
    weight = inner[:, band].astype(float)
    counts = weight.sum(axis=(0, 1))
    sums = (images[:, :, band].mean(axis=0) * weight).sum(axis=(0, 1))
    columns = np.flatnonzero(counts)
    x_mm = (columns - (inner.shape[2] - 1) / 2) * regions.spacing[2]
    return x_mm, sums[columns] / counts[columns]


def changes_by_effect(
    recorded: np.ndarray,
    simulated: Mapping[str, np.ndarray],
    images: Callable[[Fit], np.ndarray],
    choice: Choice,
    regions: Regions,
    independent: float,
    features: Features | None,
) -> dict:
    """Return the differences between recording and simulation in images, and the change by each effect.

    Parameters
    ----------
    simulated : mapping of str to ndarray
        Images with alignment alone, "before", and with the chosen effects, "after"; for the rest see
        `agreement_and_changes` and `image_changes`.

    Returns
    -------
    dict
        Changes, each as {quantity: {"value", "error"}}

        * recorded: recording minus "before"
        * effects: by effect, the change relative to a refit without it
        * together: the change by all effects
        * remaining: recording minus "after", if there are effects
    """
    before, after, effects = simulated["before"], simulated["after"], choice.chosen.fit.effects

    def compared(reference: np.ndarray, others: np.ndarray, paired: bool) -> dict[str, dict[str, float]]:
        found = image_changes(reference, others, regions, independent, features, paired)
        return {name: asdict(change) for name, change in found.items()}

    result = {"recorded": compared(before, recorded, paired=False), "effects": {}, "together": {}}
    if not effects:
        return result
    result["together"] = compared(before, after, paired=True)
    for name in effects:
        alone = len(effects) == 1
        changed = result["together"] if alone else compared(images(choice.without[name]), after, paired=True)
        result["effects"][name] = changed
    return result | {"remaining": compared(after, recorded, paired=False)}


def judge_relevance(content: Mapping, thresholds: Mapping[str, float]) -> dict:
    """Apply the relevance thresholds to a diagnosis.

    Effects are named as missing only if they change images by more than a threshold, each or all together. If none is
    named, the verdict is unexplained if recording and simulation differ by more than a threshold, otherwise a match
    for practical purposes. A match, a contradicted declaration and a recording without images keep their verdict.

    Parameters
    ----------
    content : mapping
        Content of diagnosis.json, with `practice` (`changes_by_effect`) in its agreement.
    thresholds : mapping of str to float
        By quantity of verdict_text.DIFFERENCES. With 0 every effect is relevant.

    Returns
    -------
    dict
        Content with the verdict and `practice`: thresholds, the changes, `small` (effects below the thresholds) and
        `differing` ({quantity: difference of recording and simulation above its threshold}).
    """
    agreed = dict(content.get("agreement") or {})
    changes = agreed.pop("practice", None)
    content = {**content, "agreement": agreed}
    if changes is None:
        return content
    names = [effect["name"] for effect in content["effects"]]
    small = [name for name in names if not above_thresholds(changes["effects"][name], thresholds)]
    if small == names and above_thresholds(changes["together"], thresholds):
        small = []  # each effect alone is below the thresholds, all together are not
    differing = above_thresholds(changes["recorded"], thresholds)
    content["practice"] = {"thresholds": dict(thresholds), **changes, "small": small, "differing": differing}
    # A declared value that does not fit is a finding even if images agree.
    if content["verdict"] != MATCH and small == names and not contradiction(content):
        content["verdict"] = UNEXPLAINED if differing else PRACTICAL
    return content


def above_thresholds(changes: Mapping[str, Mapping[str, float]], thresholds: Mapping[str, float]) -> dict[str, float]:
    """Return the values of quantities that exceed their threshold by more than two standard errors.

    Parameters
    ----------
    changes : mapping of str to mapping
        {quantity: {"value", "error"}}.
    """
    return {
        name: changes[name]["value"]
        for name in DIFFERENCES
        if name in changes and abs(changes[name]["value"]) - 2 * changes[name]["error"] > thresholds[name]
    }


def measured_areas(regions: Regions) -> list[np.ndarray]:
    """Return the areas whose mean HU is compared: ROIs, and squares that cover the object, through all slices."""
    inner = regions.inner
    found = [mask for mask in regions.rois.values() if mask.any()]
    _, rows, columns = inner.shape
    for y in range(0, rows - BLOCK_VOXELS + 1, BLOCK_VOXELS):
        for x in range(0, columns - BLOCK_VOXELS + 1, BLOCK_VOXELS):
            square = np.zeros_like(inner)
            square[:, y : y + BLOCK_VOXELS, x : x + BLOCK_VOXELS] = True
            square &= inner
            if square.sum() >= inner.shape[0] * BLOCK_VOXELS**2 / 2:  # smaller areas at the rim are too noisy
                found.append(square)
    return found


def _hu(reference: np.ndarray, images: np.ndarray, regions: Regions, independent: float, paired: bool) -> ImageChange:
    """Return the largest mean difference of an area, or the RMS inside the object if its lower limit is larger."""
    found = [_of_areas(reference, images, regions, paired)]
    if regions.inner.any():
        found.append(_root_mean_square(reference, images, regions, independent, paired))
    return max(found, key=lambda change: (change.least, abs(change.value)))


def _root_mean_square(
    reference: np.ndarray, images: np.ndarray, regions: Regions, independent: float, paired: bool
) -> ImageChange:
    """Return the RMS of the mean difference inside the object, corrected for noise; it shows rings and streaks."""
    inside = [stack[:, regions.inner] for stack in (reference, images)]
    difference, error = _paired(*inside) if paired else _unpaired(*inside)
    noise = float((error**2).mean())
    if not np.isfinite(noise):
        return ImageChange(0.0, 0.0)  # with single repeats noise and structure cannot be distinguished
    square = max(0.0, float((difference**2).mean()) - noise)
    value = np.sqrt(square)
    if not noise:  # paired images of single repeats, or without noise
        return ImageChange(float(value), 0.0)
    # Variances of the squared difference of independent values, and of its noise as estimated from few repeats.
    relative = 2 / independent + (0.0 if paired else 1 / (len(images) - 1) / independent)
    least = np.sqrt(max(0.0, square - 2 * noise * np.sqrt(relative)))
    return ImageChange(float(value), float(value - least) / 2)


def _of_areas(reference: np.ndarray, images: np.ndarray, regions: Regions, paired: bool) -> ImageChange:
    """Return the largest mean difference of an area, with an error that is corrected for the number of areas."""
    areas = measured_areas(regions)
    if not areas:
        raise InputError("mean HU need a region in the image; there is none")
    means = [np.stack([stack[:, mask].mean(axis=1) for mask in areas], axis=1) for stack in (reference, images)]
    difference, error = _paired(*means) if paired else _unpaired(*means)
    # Bonferroni correction over the areas, instead of the 5 % that two standard errors leave. Differences of unpaired
    # images have the noise of few repeats.
    freedom, level = len(reference) + len(images) - 2, ALPHA / 2 / len(areas)
    wider = (stats.norm.isf(level) if paired or not freedom else stats.t.isf(level, freedom)) / 2
    limits = np.abs(difference) - 2 * wider * error
    worst = int(np.argmax(limits if np.isfinite(limits).all() else np.abs(difference)))
    return ImageChange(float(difference[worst]), _known(wider * error[worst]))


def _percent(reference: np.ndarray, images: np.ndarray, measure: Callable, paired: bool) -> ImageChange:
    """Return the relative difference of a measure in percent."""
    first, second = measure(reference), measure(images)
    ratio = second.value / first.value
    relative_error = np.hypot(first.error / first.value, second.error / second.value)
    # Paired images have the same noise.
    return ImageChange(100 * (ratio - 1), 0.0 if paired else 100 * ratio * _known(relative_error))


def _shift(reference: np.ndarray, images: np.ndarray, paired: bool) -> ImageChange:
    """Return the largest significant mean shift of a feature, in SDs of a repeat; 0 if none is significant."""
    sd = spread(reference)
    size = np.maximum(np.abs(reference).max(axis=0), np.abs(images).max(axis=0))
    difference, error = _paired(reference, images) if paired else _unpaired(reference, images)
    shift = in_sd(difference, sd, size)
    with np.errstate(invalid="ignore", divide="ignore"):
        t = np.where(error > 0, np.abs(difference) / error, np.where(difference == 0, 0.0, np.inf))
    p = 2 * stats.t.sf(t, len(reference) - 1)
    real = (holm(p) < ALPHA) & np.isfinite(shift)
    if not real.any():
        return ImageChange(0.0, 0.0)
    worst = int(np.argmax(np.where(real, np.abs(shift), 0)))
    return ImageChange(float(shift[worst]), _known(error[worst] / sd[worst] if sd[worst] else 0.0))


def _paired(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean difference of paired repeats and its standard error."""
    difference = second - first
    error = difference.std(axis=0, ddof=1) / np.sqrt(len(first)) if len(first) > 1 else np.zeros(first.shape[1])
    return difference.mean(axis=0), error


def _unpaired(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the difference of means and its standard error; NaN for single repeats."""
    parts = [
        stack.var(axis=0, ddof=1) / len(stack) if len(stack) > 1 else np.full(stack.shape[1], np.nan)
        for stack in (first, second)
    ]
    return second.mean(axis=0) - first.mean(axis=0), np.sqrt(sum(parts))


def _known(error: float) -> float:
    """Return a standard error; 0 if single repeats give none, so that their differences are reported."""
    return float(error) if np.isfinite(error) else 0.0
