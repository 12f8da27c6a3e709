"""Check that an image can be a CT in HU and in mm, by its CT numbers, value range and lengths.

NIfTI files do not state the unit of voxel values, and rarely the unit of length. Each check can be disabled by name
(`not_checked`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from ..base.console import note
from ..base.errors import InputError, InputErrors, did_you_mean
from ..base.geometry import Grid
from ..base.units import HU_AIR, HU_BODY

HU, WINDOW, SIZE = CHECKS = ("hu", "window", "size")
MOST_VOXELS = 2_000_000  # of larger images, every n-th voxel along each axis is used

# Attenuation per mm or cm, z-scores and images scaled to 1 are within this value; a CT has air, fat or noise beyond.
LARGEST_NORMALIZED = 10.0
TAILS = (0.1, 99.9)  # percentiles used as the range, so that a few voxels of metal do not matter
BELOW_AIR_HU = -1100.0  # air with noise is rarely lower; padding outside the scanned circle is
PADDING = 0.01  # more voxels than this fraction with the lowest value, below air: padding
AIR_HU = (-1150.0, -850.0)  # air outside the body: beam hardening and scatter of cone-beam CT shift it by up to 100 HU
SOME_AIR = 0.01  # least fraction of voxels in AIR_HU of an image with air
# Water and soft tissue stored as HU + 1000 or HU + 1024; in HU only dense bone and PTFE.
OFFSET_TISSUE = (900.0, 1300.0)
MOST_DENSE = 0.1  # largest fraction of voxels in OFFSET_TISSUE of an image without air
LARGEST_LABEL = 255  # 8 bits. Whole numbers up to this value without noise are labels: a CT has air at -1000
# Distance of the lower level from 0, in SDs, with which normal noise in 1e4 voxels has no value below 0. The median of
# Rayleigh noise (of magnitudes) is 1.8 SD.
NORMAL_NOISE = 3.0
DENSEST_LEVEL_HU = 1400.0  # largest level of many voxels: cortical bone and PTFE are less dense, metal is in few voxels
LEAST_DENSE = 0.0005  # least fraction of voxels of the body: a mouse in a field of view of 500 mm has 0.003
CONTRAST_HU = (700.0, 1400.0)  # contrast of the body to air: 1000 for water, more for bone and contrast agents
FAINT_HU = 90.0  # contrast of two separate levels; fat and muscle have 150, so the scale is wrong if it is less
# The same limit, if the lower level fills this fraction of the border of the slices, as air does but fat does not.
FAT_HU, ALL_AROUND = 130.0, 0.98
LOWEST_AIR_HU = -1500.0  # lower of two separate levels, without padding; noise does not shift a median
HIGHEST_SOFT_HU = 400.0  # median of an image without air, such as a part of an organ
SEPARATE = 0.9  # variance fraction between two levels: 0.64 for one normal distribution, 0.98 for air and water

SPIKE = 5.0  # ratio of voxels at the end of the range to voxels near it, if clipped; below 1 without clipping
SPIKE_NEAR, MASKED_NEAR = 10.0, 3.0  # distance of values near the end of the range, or near the most frequent value
CLIPPED_LOW = 0.01  # least fraction of voxels at the lowest value, if clipped
CLIPPED_HIGH = 0.002  # same for the body at the highest value: cortical bone has 1 to 5 %, metal less
HIGHEST_CLIP_HU = 1900.0  # ranges of scanners end at 1976 HU (12 bits with 1000 above water), 3071 or higher
MASKED = 0.1  # fraction of voxels with the same value in an image with noise: the outside was set to it
NOISE_FREE = 0.6  # fraction of equal neighbors in a drawn phantom, for which clipping is not checked
LOWEST_TISSUE_HU = -130.0  # fat

# A body narrower than 60 mm in an image narrower than 100 mm is probably a patient in cm. The widest body in the bore
# of a scanner (700 to 800 mm with its table) is 600 mm, and no field of view is wider than 1000 mm. A crop within the
# body is accepted: in cm it would be half a meter of tissue.
NARROWEST_BODY_MM, NARROWEST_VIEW_MM = 60.0, 100.0
WIDEST_MM = 1500.0  # in-plane: wider than any bore with some added air
VOXEL_MM = (0.01, 20.0)  # from micro-CT to thick slices


@dataclass(frozen=True)
class _Values:
    """Sampled voxels of an image.

    Attributes
    ----------
    array : ndarray, shape (z, y, x)
        Every n-th voxel.
    lowest, highest : float
        Range of the whole image.
    values : ndarray, shape (n,)
        Values of `array` without padding.
    """

    array: np.ndarray
    lowest: float
    highest: float
    values: np.ndarray
    noise_free: bool

    def share(self, low: float, high: float) -> float:
        """Return the fraction of all voxels between two values."""
        return float(np.count_nonzero((self.values > low) & (self.values < high)) / self.array.size)


def require_plausible(array: np.ndarray, grid: Grid, source: object, not_checked: Collection[str] = ()) -> None:
    """Check that an image of finite values [z, y, x] can be a CT in HU and mm.

    Parameters
    ----------
    source : object
        Start of messages.
    not_checked : collection of str, optional
        Members of CHECKS that are skipped.

    Raises
    ------
    InputErrors
        A line for each check that fails.
    """
    image = _values(array)
    found = {
        HU: [line for line in (_without_hu(image) or _shifted(image),) if line],
        WINDOW: [*_range(image)],
        SIZE: [*_lengths(array, grid)],
    }
    lines = [
        f"{source}: {line} (if it is right: not_checked: [{name}])"
        for name in CHECKS
        if name not in not_checked
        for line in found[name]
    ]
    if lines:
        raise InputErrors(lines)


def require_known_checks(names: Collection[str]) -> None:
    """Check names given by the option --not-checked."""
    if wrong := [name for name in names if name not in CHECKS]:
        raise InputError(f"--not-checked: there is no check '{wrong[0]}'; {did_you_mean(wrong[0], CHECKS)}")


def has_air(array: np.ndarray) -> bool:
    """Return whether an image shows air (HU)."""
    low, high = AIR_HU
    sampled = _thinned(array)
    return bool(np.count_nonzero((sampled > low) & (sampled < high)) > SOME_AIR * sampled.size)


def note_without_air(array: np.ndarray, source: object) -> None:
    """Print a note if an image (HU) has no air, as it was cropped within the body."""
    if not has_air(array):
        note(f"{source}: shows no air (-1000 HU), so it is treated as cropped within the body, with air outside")


def _thinned(array: np.ndarray) -> np.ndarray:
    step = max(1, int(np.ceil((array.size / MOST_VOXELS) ** (1 / 3))))
    return array[tuple(slice(None, None, min(step, max(1, n // 8))) for n in array.shape)]


def _values(array: np.ndarray) -> _Values:
    sampled = _thinned(array)
    lowest, highest = float(array.min()), float(array.max())
    rest = sampled.ravel()
    if lowest < BELOW_AIR_HU and np.count_nonzero(rest == lowest) > PADDING * rest.size:
        rest = rest[rest != lowest]
    return _Values(sampled, lowest, highest, rest, _is_noise_free(sampled))


def _is_noise_free(array: np.ndarray) -> bool:
    """Return whether most neighbors are equal, without the most frequent, lowest and highest values."""
    values, counts = np.unique(array, return_counts=True)
    inner = ~np.isin(array, [values[0], values[-1], values[counts.argmax()]])
    both = inner[..., 1:] & inner[..., :-1]
    if not both.any():
        return len(values) < 100
    return bool((array[..., 1:] == array[..., :-1])[both].mean() > NOISE_FREE)


def _without_hu(image: _Values) -> str | None:
    """Return a message if the range shows that values are not HU."""
    if not image.values.size:
        return None
    low, high = np.percentile(image.values, TAILS).tolist()
    given = f"values go from {image.lowest:.3g} to {image.highest:.3g}, so these are not HU"
    air, body, explained = _levels(image.values)
    if 0 <= image.lowest and image.highest <= LARGEST_LABEL and image.noise_free:
        values = np.unique(image.array)
        if len(values) == 1:
            return f"has the same value everywhere ({values[0]:g})"
        if (values == np.rint(values)).all():
            count = len(values)
            return f"has {count} different whole numbers up to {image.highest:g}, as a label map or mask: give the CT"
    if max(-low, high) < LARGEST_NORMALIZED:
        if image.lowest in (-1, 0) and image.highest == 1:
            return f"{given}; they were scaled to {image.lowest:g} to 1: take the CT before scaling"
        if -1.15 < air < -0.85 and -0.3 < body < 0.4:
            return f"{given}; perhaps HU / 1000: multiply by 1000"
        if -air > 0.2 * (body - air):  # air in mu is 0
            return f"{given}; perhaps normalized by mean and SD: take the CT before that, or give value * SD + mean"
        return f"{given}; perhaps attenuation mu: give 1000 (mu / mu_water - 1)"
    if image.lowest > 0 and explained > SEPARATE and _ends_at_zero(image, body):
        return f"{given}; perhaps magnitudes, as of MR, or HU + 1024: take a CT in HU"
    if image.lowest < 0 or (image.lowest > 0 and _is_crop_of_tissue(image, body, explained)):
        return None
    if image.highest <= 255:
        return f"{given}; perhaps gray values of a picture (8 bits): take the CT itself"
    if image.highest > 2**15:
        return f"{given}; perhaps negative HU stored without a sign: subtract 65536 from values above 32767"
    return "has no value below 0, so these are not HU; perhaps HU + 1024: subtract 1024 first"


def _is_crop_of_tissue(image: _Values, upper: float, explained: float) -> bool:
    """Return whether values above 0 can be HU of soft tissue and bone, without air or fat."""
    soft = float(np.median(image.values)) < HIGHEST_SOFT_HU
    one_level = explained < SEPARATE
    return soft and (one_level or (image.highest > 255 and not _between(upper, OFFSET_TISSUE)))


def _ends_at_zero(image: _Values, upper: float) -> bool:
    """Return whether all values of the lower level are above 0 although normal noise would go below."""
    below = image.values[image.values < upper / 2]
    if not below.size or image.noise_free:
        return False
    level = float(np.median(below))
    return level < NORMAL_NOISE * 1.4826 * float(np.median(np.abs(below - level)))  # the SD of normal noise by its MAD


def _shifted(image: _Values) -> str | None:
    """Return a message if the levels of air or of the body are not those in HU."""
    if not image.values.size:
        return None
    padding = image.array.size - image.values.size
    if padding and np.count_nonzero(image.values > HU_BODY) < LEAST_DENSE * image.values.size:
        return (
            f"apart from {image.lowest:g}, no voxels are denser than {HU_BODY:g}; perhaps HU - 1000 or HU - 1024: "
            "add 1000 or 1024"
        )
    air, body, explained = _levels(image.values)
    shows_air = image.share(*AIR_HU) > SOME_AIR and not _is_padding_only(image)
    dense = image.share(*OFFSET_TISSUE)
    if not shows_air and dense > MOST_DENSE:
        given = f"{100 * dense:.0f} % of the voxels are between {OFFSET_TISSUE[0]:g} and {OFFSET_TISSUE[1]:g}"
        if np.median(_rim(image.array)) > HU_BODY + 1000:
            return f"{given}, and they surround the rest: the values are inverted; multiply by -1"
        return f"{given}: 1000 or 1024 was added to HU; subtract it first"
    contrast = body - air
    if explained > SEPARATE and CONTRAST_HU[0] < contrast < CONTRAST_HU[1] and not _between(air, AIR_HU):
        # Lungs of a crop without outer air are 100 to 400 HU above air, with vessels in them.
        if air < AIR_HU[0] or (air > -400 and not shows_air):
            shift = air - HU_AIR
            advice = f"subtract {shift:.0f}" if shift > 0 else f"add {-shift:.0f}"
            return f"air is at about {air:.0f}, not {HU_AIR:g} HU; {advice}"
    if explained > SEPARATE and not shows_air and body > DENSEST_LEVEL_HU:
        upper = np.count_nonzero(image.values > (air + body) / 2) / image.values.size
        if upper > MOST_DENSE:
            return (
                f"{100 * upper:.0f} % of the voxels are near {body:.0f}, denser than bone, and there is no air at "
                f"{HU_AIR:g}; correct offset and slope"
            )
    if explained > SEPARATE and air < LOWEST_AIR_HU:
        return f"air is at about {air:.0f}, not {HU_AIR:g} HU; correct offset and slope"
    faint = contrast < FAINT_HU or (contrast < FAT_HU and np.mean(_rim(image.array) < (air + body) / 2) > ALL_AROUND)
    if explained > SEPARATE and 0 < contrast and faint and not image.noise_free:
        return (
            f"most values are near {air:.0f} or {body:.0f}; air and water in HU differ by 1000: perhaps the scale was "
            "lost (RescaleSlope, or mu per m); take the unprocessed CT"
        )
    rim = _rim(image.array)
    rim = rim[rim >= BELOW_AIR_HU] if image.lowest < BELOW_AIR_HU else rim
    level = float(np.median(rim)) if rim.size else HU_AIR
    if -800 < level < -250 and np.mean(np.abs(rim - level) < 100) > 0.9:
        return f"the surroundings of the body are at {level:.0f} HU, but air is {HU_AIR:g}; correct offset and slope"
    return None


def _is_padding_only(image: _Values) -> bool:
    """Return whether air is one exact value at the low end, and all other values, with noise, are far above."""
    low, high = AIR_HU
    air = image.values[(image.values > low) & (image.values < high)]
    same = air.size and np.count_nonzero(air == image.lowest) > 0.99 * air.size
    return bool(same and not image.noise_free and image.share(high, HU_BODY) < SOME_AIR)


def _between(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def _rim(array: np.ndarray) -> np.ndarray:
    """Return the voxels at the border of all slices."""
    return np.concatenate([edge.ravel() for edge in (array[:, 0], array[:, -1], array[:, :, 0], array[:, :, -1])])


def _levels(values: np.ndarray) -> tuple[float, float, float]:
    """Split values into two classes (Otsu, IEEE Trans. Syst. Man Cybern. 9, 62, 1979).

    Returns
    -------
    low, high : float
        Medians of the classes.
    explained : float
        Fraction of the variance between the classes.
    """
    low, high = np.percentile(values, TAILS)
    limited = np.clip(values, low, high)
    counts, edges = np.histogram(limited, 512)
    centers = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)
    total, moment = below[-1], np.cumsum(counts * centers)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * below / total - moment) ** 2 / (below * (total - below))
    between = np.where(np.isfinite(between), between, 0)
    best = int(between.argmax())
    variance = float(np.var(limited, dtype=np.float64))
    lower = limited <= edges[best + 1]
    if variance == 0 or lower.all():
        return float(low), float(low), 0.0
    return float(np.median(limited[lower])), float(np.median(limited[~lower])), float(between[best] / variance)


def _range(image: _Values) -> Iterator[str]:
    """Yield messages about values that were clipped, or set to one value outside of the body."""
    if max(-image.lowest, image.highest) < LARGEST_NORMALIZED or not image.values.size or image.lowest >= 0:
        return  # not HU, which `_without_hu` reports
    at_low = np.count_nonzero(image.array == image.lowest) / image.array.size
    lowest_is_tissue = image.lowest > AIR_HU[1]
    if lowest_is_tissue and at_low > CLIPPED_LOW:
        if (image.lowest < LOWEST_TISSUE_HU) if image.noise_free else _spike(image, image.lowest, SPIKE_NEAR):
            yield (
                f"{100 * at_low:.0f} % of the voxels are exactly {image.lowest:g}, the lowest value: it was clipped to "
                "a display window, and its air is lost; take the unprocessed CT"
            )
            return
    if image.noise_free:
        return
    values, counts = np.unique(image.values, return_counts=True)
    most = float(values[counts.argmax()])
    share = counts.max() / image.array.size
    if most > AIR_HU[1] and share > MASKED and image.lowest < most < image.highest and _spike(image, most, MASKED_NEAR):
        yield (
            f"{100 * share:.0f} % of the voxels are exactly {most:g}: the surroundings of the body were set to this "
            f"value; set them to {HU_AIR:g}"
        )
    body = np.count_nonzero(image.values > HU_BODY)
    at_high = np.count_nonzero(image.values == image.highest)
    if (
        HU_BODY < image.highest < HIGHEST_CLIP_HU
        and at_high > CLIPPED_HIGH * body
        and _spike(image, image.highest, SPIKE_NEAR)
    ):
        yield (
            f"{100 * at_high / body:.1f} % of the body's voxels are exactly {image.highest:g}, the highest value: it "
            "was clipped to a display window; take the unprocessed CT"
        )


def _spike(image: _Values, value: float, reach: float) -> bool:
    """Return whether far more voxels have a value than have values near it."""
    around = np.abs(image.values - value)
    near = np.count_nonzero((around > 0) & (around <= reach))
    width = reach if value in (image.lowest, image.highest) else 2 * reach
    return np.count_nonzero(around == 0) > SPIKE * max(near / width, 1)


def _lengths(array: np.ndarray, grid: Grid) -> Iterator[str]:
    """Yield a message if lengths are not in mm."""
    small, large = min(grid.spacing), max(grid.spacing)
    wide = grid.extent_mm[1:]
    if max(wide) > WIDEST_MM:
        yield f"is {max(wide):.3g} mm wide, where up to {WIDEST_MM:g} mm are expected; are its lengths in mm?"
    elif small < VOXEL_MM[0] or large > VOXEL_MM[1]:
        size = " x ".join(f"{step:.3g}" for step in grid.spacing[::-1])
        yield f"has voxels of {size} mm (x, y, z); are its lengths in mm?"
    elif _is_identity(grid):
        yield (
            "has voxels of 1 x 1 x 1 mm with the first at (0, 0, 0), so its voxel size was lost; write "
            "the CT's affine into it, and into files of its regions"
        )
    elif max(wide) < NARROWEST_VIEW_MM and 0 < (body := _width_mm(array, grid)) < NARROWEST_BODY_MM:
        yield (
            f"is {max(wide):.3g} mm wide and the body in it {body:.3g} mm, where at least {NARROWEST_BODY_MM:g} mm are "
            "expected; are its lengths in mm, not in cm?"
        )


def _is_identity(grid: Grid) -> bool:
    """Return whether the affine is the identity, up to the signs of its axes."""
    corners = (abs(abs(c) - (n - 1) / 2) < 1e-3 for c, n in zip(grid.centre_mm, grid.shape[::-1], strict=True))
    return all(abs(step - 1) < 1e-6 for step in grid.spacing) and all(corners)


def _width_mm(array: np.ndarray, grid: Grid) -> float:
    """Return the in-plane width of voxels denser than HU_BODY; 0 if they fill the image or there are none."""
    dense = (array > HU_BODY).any(axis=0)
    spans = [np.flatnonzero(dense.any(axis=axis)) for axis in (1, 0)]
    pixels = [int(span[-1] - span[0]) + 1 if span.size else 0 for span in spans]
    if pixels == list(dense.shape):
        return 0.0
    return max(n * wide for n, wide in zip(pixels, grid.spacing[1:], strict=True))
