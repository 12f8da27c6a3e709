"""What a difference means in images: in HU, per cent of contrast, noise and resolution, and repeat SDs of features.

A difference of projections may be significant and yet too small for anybody to see in an image. These are the terms in
which users of images feel it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from ...base.errors import InputError
from ...statistics.comparison import ALPHA, in_sd, spread
from ...statistics.image_quality import Measure, contrast, noise_magnitude, noise_spectrum
from ...statistics.multiplicity import holm
from ...statistics.resolution import mtf_half
from ..fitting.fit import Fit
from ..selection.forward_selection import Choice
from .agreement import Features, Regions, agreement

# Side of the squares whose mean HU is compared: that of the smallest which noise spectra are taken of.
BLOCK_VOXELS = 8


@dataclass(frozen=True)
class Change:
    """One quantity's change.

    Attributes
    ----------
    value : float
        In the unit that its name says (core.sentence.UNITS).
    error : float
        Standard error that the images' noise leaves it; of the largest of many places it covers their number.
    """

    value: float
    error: float

    @property
    def least(self) -> float:
        """Size that it has for sure: with two standard errors taken off."""
        return max(0.0, abs(self.value) - 2 * self.error)


def changes(
    without: np.ndarray, images: np.ndarray, regions: Regions, features: Features | None = None, paired: bool = False
) -> dict[str, Change]:
    """How far images differ from others.

    Parameters
    ----------
    without, images : ndarray, shape (repeats, z, y, x)
        HU.
    features : Features, optional
        None: features are left out.
    paired : bool, optional
        The repeats' noise is the same in both, so that only differences of repeats are uncertain.

    Returns
    -------
    dict of str to Change
        By core.sentence.UNITS, those that can be measured: noise needs two repeats, contrast two ROIs.
    """
    makers: dict[str, Callable[[], Change]] = {
        "hu": lambda: _hu(without, images, regions, paired),
        "contrast_percent": lambda: _percent(without, images, lambda x: contrast(x, regions.rois), paired),
        "noise_percent": lambda: _percent(without, images, lambda x: _noise(x, regions), paired),
        "resolution_percent": lambda: _percent(
            without, images, lambda x: mtf_half(x, regions.distance_mm, regions.spacing, regions.valid), paired
        ),
    }
    if features is not None:
        makers["features_sd"] = lambda: _shift(features.of(without, "without"), features.of(images, "with"), paired)
    found = {}
    for name, make in makers.items():
        try:
            found[name] = make()
        except InputError:
            continue
    return found


def agreement_and_practice(
    recorded: np.ndarray,
    images: Callable[[Fit], np.ndarray],
    choice: Choice,
    regions: Regions,
    features: Features | None,
    practice: bool,
) -> dict:
    """Agreement of a choice's models with recorded images, and what effects change in them.

    Parameters
    ----------
    recorded : ndarray, shape (repeats, z, y, x)
        HU.
    images : callable
        Images of a fit, all with the same noise.
    practice : bool
        Whether it is told what effects change.

    Returns
    -------
    dict
        That of agreement.agreement, with rois (names), repeats (number) and, if asked for, practice (`told`).
    """
    simulated = {"before": images(choice.baseline.fit), "after": images(choice.chosen.fit)}
    more = {"practice": told(recorded, simulated, images, choice, regions, features)} if practice else {}
    found = agreement(recorded, simulated, regions, features=features)
    return found | more | {"rois": list(regions.rois), "repeats": len(recorded)}


def told(
    recorded: np.ndarray,
    simulated: Mapping[str, np.ndarray],
    images: Callable[[Fit], np.ndarray],
    choice: Choice,
    regions: Regions,
    features: Features | None,
) -> dict:
    """What diagnosis.json holds of it.

    Parameters
    ----------
    recorded : ndarray, shape (repeats, z, y, x)
        HU.
    simulated : mapping of str to ndarray
        Those of the alignment alone, "before", and of the chosen effects, "after".
    images : callable
        Images of a fit, with the noise of `simulated`.

    Returns
    -------
    dict
        {"recorded": what the recording has beside "before"; "effects": {name: what the effect changes, the others and
        the alignment fitted again without it}; "together": what all of them change}, each {quantity: {"value",
        "error"}}.
    """
    before, after = simulated["before"], simulated["after"]
    found = {"recorded": _stated(changes(before, recorded, regions, features)), "effects": {}, "together": {}}
    effects = choice.chosen.fit.effects
    if effects:
        found["together"] = _stated(changes(before, after, regions, features, paired=True))
    for name in effects:
        alone = len(effects) == 1
        left = before if alone else images(choice.without[name])
        found["effects"][name] = (
            found["together"] if alone else _stated(changes(left, after, regions, features, paired=True))
        )
    return found


def _stated(found: Mapping[str, Change]) -> dict[str, dict[str, float]]:
    return {name: asdict(one) for name, one in found.items()}


def places(regions: Regions) -> list[np.ndarray]:
    """Where mean HU are compared: the ROIs, and squares all over the inside of the object, through all slices.

    Returns
    -------
    list of ndarray of bool, shape (z, y, x)
    """
    inner = regions.inner
    found = [mask for mask in regions.rois.values() if mask.any()]
    _, rows, columns = inner.shape
    for y in range(0, rows - BLOCK_VOXELS + 1, BLOCK_VOXELS):
        for x in range(0, columns - BLOCK_VOXELS + 1, BLOCK_VOXELS):
            square = np.zeros_like(inner)
            square[:, y : y + BLOCK_VOXELS, x : x + BLOCK_VOXELS] = True
            square &= inner
            if square.sum() >= inner.shape[0] * BLOCK_VOXELS**2 / 2:  # a few voxels at the rim are only noise
                found.append(square)
    return found


def _hu(without: np.ndarray, images: np.ndarray, regions: Regions, paired: bool) -> Change:
    """The largest mean difference of a place, or the root mean square inside the object: what is surer to be large."""
    found = [_of_places(without, images, regions, paired)]
    if regions.inner.any():
        found.append(_root_mean_square(without, images, regions, paired))
    return max(found, key=lambda one: (one.least, abs(one.value)))


def _root_mean_square(without: np.ndarray, images: np.ndarray, regions: Regions, paired: bool) -> Change:
    """Of the mean difference inside, without what noise puts into it: rings and streaks have no mean."""
    inside = [one[:, regions.inner] for one in (without, images)]
    difference, error = _paired(*inside) if paired else _apart(*inside)
    noise = float((error**2).mean())
    if not np.isfinite(noise):
        return Change(0.0, 0.0)  # single repeats: noise and structure cannot be told apart
    square = max(0.0, float((difference**2).mean()) - noise)
    independent = regions.inner.sum() / max(_area(one, regions) for one in (without, images))
    value = np.sqrt(square)
    least = np.sqrt(max(0.0, square - 2 * noise * np.sqrt(2 / independent)))
    return Change(float(value), float(value - least) / 2)


def _of_places(without: np.ndarray, images: np.ndarray, regions: Regions, paired: bool) -> Change:
    """The largest mean difference, and the error that leaves nothing to chance of the largest of so many."""
    where = places(regions)
    if not where:
        raise InputError("mean HU need a region in the image; there is none")
    means = [np.stack([one[:, mask].mean(axis=1) for mask in where], axis=1) for one in (without, images)]
    difference, error = _paired(*means) if paired else _apart(*means)
    # Bonferroni over the places, in the place of the 1 of 20 that two standard errors leave.
    wider = stats.norm.isf(ALPHA / 2 / len(where)) / 2
    sure = np.abs(difference) - 2 * wider * error
    worst = int(np.argmax(sure if np.isfinite(sure).all() else np.abs(difference)))
    return Change(float(difference[worst]), _known(wider * error[worst]))


def _percent(without: np.ndarray, images: np.ndarray, measure: Callable, paired: bool) -> Change:
    """Relative difference of a measure, per cent."""
    first, second = measure(without), measure(images)
    ratio = second.value / first.value
    if paired:  # its noise is in both alike
        return Change(100 * (ratio - 1), 0.0)
    return Change(
        100 * (ratio - 1), 100 * ratio * _known(np.hypot(first.error / first.value, second.error / second.value))
    )


def _noise(images: np.ndarray, regions: Regions) -> Measure:
    return noise_magnitude(images, {"object": regions.inner}, _area(images, regions))


def _area(images: np.ndarray, regions: Regions) -> float:
    """Voxels that hold one independent value of the noise; 1 where the object is too small for a spectrum."""
    try:
        return noise_spectrum(images, regions.inner, regions.spacing).area
    except InputError:
        return 1.0


def _shift(without: np.ndarray, images: np.ndarray, paired: bool) -> Change:
    """The largest mean shift of a feature that is no chance, in SDs of a repeat; 0 where none is."""
    sd = spread(without)
    size = np.maximum(np.abs(without).max(axis=0), np.abs(images).max(axis=0))
    difference, error = _paired(without, images) if paired else _apart(without, images)
    shift = in_sd(difference, sd, size)
    with np.errstate(invalid="ignore", divide="ignore"):
        t = np.where(error > 0, np.abs(difference) / error, np.where(difference == 0, 0.0, np.inf))
    p = 2 * stats.t.sf(t, len(without) - 1)
    real = (holm(p) < ALPHA) & np.isfinite(shift)
    if not real.any():
        return Change(0.0, 0.0)
    worst = int(np.argmax(np.where(real, np.abs(shift), 0)))
    return Change(float(shift[worst]), _known(error[worst] / sd[worst] if sd[worst] else 0.0))


def _paired(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean difference of repeats, and its standard error."""
    difference = second - first
    error = difference.std(axis=0, ddof=1) / np.sqrt(len(first)) if len(first) > 1 else np.zeros(first.shape[1])
    return difference.mean(axis=0), error


def _apart(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Difference of means, and its standard error; NaN of single repeats."""
    parts = [
        one.var(axis=0, ddof=1) / len(one) if len(one) > 1 else np.full(one.shape[1], np.nan) for one in (first, second)
    ]
    return second.mean(axis=0) - first.mean(axis=0), np.sqrt(sum(parts))


def _known(error: float) -> float:
    """A standard error; 0 where single repeats leave none, so that what differs there is told."""
    return float(error) if np.isfinite(error) else 0.0
