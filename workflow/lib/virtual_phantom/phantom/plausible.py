"""Whether an image can be a CT in HU and in mm: its CT numbers, its value range, its lengths.

NIfTI does not state what voxel values mean, and rarely the unit of length. A rescale gets lost easily. The checks
refuse what no CT shows. Each has a name under which a user can switch it off (`not_checked`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from ..base.console import note
from ..base.errors import InputError, InputErrors, meant
from ..base.geometry import Grid
from ..base.units import HU_AIR, HU_BODY

HU, WINDOW, SIZE = CHECKS = ("hu", "window", "size")
MOST_VOXELS = 2_000_000  # of a large image every n-th voxel along each axis is looked at

# Attenuation per mm or cm, z-scores and images scaled to 1 are within it; a CT has air, fat or noise beyond it.
LARGEST_NORMALIZED = 10.0
TAILS = (0.1, 99.9)  # percentiles that are taken as the range: a few voxels of metal in mu or z-scores do not hide it
BELOW_AIR_HU = -1100.0  # the noise of air rarely goes lower in numbers: padding outside the scanned circle
PADDING = 0.01  # share of voxels with the lowest value, below air: padding rather than noise
AIR_HU = (-1150.0, -850.0)  # air outside the body: beam hardening and scatter of cone-beam CT move it by up to 100 HU
SOME_AIR = 0.01  # share of voxels there that counts as air
# Water and soft tissue stored as HU + 1000 or HU + 1024 lie here; few voxels in HU do (dense bone, PTFE).
OFFSET_TISSUE = (900.0, 1300.0)
MOST_DENSE = 0.1  # share of voxels there, in an image without air
LARGEST_LABEL = 255  # of 8 bits. Whole numbers up to it without noise are labels: a CT has air at -1000
# SD that the lower of two levels is away from 0 if normal noise, in 1e4 voxels and more, leaves no value below 0. The
# median of Rayleigh noise, of magnitudes, is 1.8 SD from 0.
NORMAL_NOISE = 3.0
DENSEST_LEVEL_HU = 1400.0  # of many voxels: cortical bone and PTFE are less dense; metal is in few
LEAST_DENSE = 0.0005  # share of voxels: a mouse in a field of view of 500 mm has 0.003
CONTRAST_HU = (700.0, 1400.0)  # of a body over the air around it; water over air is 1000, bone and contrast agents more
FAINT_HU = 90.0  # contrast of two clearly separate levels: less than fat under muscle (150), so the scale is another
FAT_HU, ALL_AROUND = 130.0, 0.98  # as little, where the lower level surrounds everything as air does, not fat
LOWEST_AIR_HU = -1500.0  # of two separate levels the lower, padding aside; noise does not move a median
HIGHEST_SOFT_HU = 400.0  # of most voxels in an image without air, such as a part of an organ
SEPARATE = 0.9  # share of the variance that two levels explain. Of one normal distribution 0.64, of air and water 0.98

SPIKE = 5.0  # times as many voxels have the value at an end as have a value near it: clipped. Without clipping below 1
SPIKE_NEAR, MASKED_NEAR = 10.0, 3.0  # values up to here from an end, or from the most frequent one, are near it
CLIPPED_LOW = 0.01  # share of voxels at the lowest value
CLIPPED_HIGH = 0.002  # share of the body's voxels at the highest value: cortical bone has 1 to 5 %, metal less
HIGHEST_CLIP_HU = 1900.0  # ranges of scanners end at 1976 HU (12 bits with 1000 above water), 3071 or higher
MASKED = 0.1  # share of voxels with one and the same value in an image with noise: what is outside was set to it
NOISE_FREE = 0.6  # share of neighbours that are equal: a drawn phantom, whose values say nothing about clipping
LOWEST_TISSUE_HU = -130.0  # fat

# A body narrower than 60 mm in an image narrower than 100 mm is more likely a patient in cm: 600 mm is the widest body
# in a scanner's bore (700 to 800 mm with its table), and no field of view is wider than 1000 mm. A crop within
# the body is left alone: in cm it would be half a metre of tissue.
NARROWEST_BODY_MM, NARROWEST_VIEW_MM = 60.0, 100.0
WIDEST_MM = 1500.0  # in-plane: the bore of any scanner, and some air that was added around
VOXEL_MM = (0.01, 20.0)  # micro-CT to thick slices; the least is a hundred times a micrometre


@dataclass(frozen=True)
class _Values:
    """Voxels to look at: padding left out, and what the rest looks like.

    Attributes
    ----------
    array : ndarray, shape (z, y, x)
        Every n-th voxel.
    lowest, highest : float
        Of the whole image.
    values : ndarray, shape (n,)
        Without padding.
    """

    array: np.ndarray
    lowest: float
    highest: float
    values: np.ndarray
    noise_free: bool

    def share(self, low: float, high: float) -> float:
        """Return the share of all voxels between two values."""
        return float(np.count_nonzero((self.values > low) & (self.values < high)) / self.array.size)


def require_plausible(array: np.ndarray, grid: Grid, source: object, not_checked: Collection[str] = ()) -> None:
    """Refuse an image that cannot be a CT in HU and mm.

    Parameters
    ----------
    array : ndarray, shape (z, y, x)
        Finite values.
    source : object
        The file, which lines begin with.
    not_checked : collection of str, optional
        Members of CHECKS that are skipped.

    Raises
    ------
    InputErrors
        A line for each check that fails.
    """
    seen = _values(array)
    found = {
        HU: [line for line in (_without_hu(seen) or _shifted(seen),) if line],
        WINDOW: [*_range(seen)],
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


def known_checks(names: Collection[str]) -> None:
    """Refuse names of checks that there are not, as given by the option --not-checked."""
    if wrong := [one for one in names if one not in CHECKS]:
        raise InputError(f"--not-checked: there is no check '{wrong[0]}'; {meant(wrong[0], CHECKS)}")


def has_air(array: np.ndarray) -> bool:
    """Return whether an image shows air (HU)."""
    low, high = AIR_HU
    looked_at = _thinned(array)
    return bool(np.count_nonzero((looked_at > low) & (looked_at < high)) > SOME_AIR * looked_at.size)


def note_without_air(array: np.ndarray, source: object) -> None:
    """Report an image (HU) without air: it ends within the body, and beyond it air is scanned."""
    if not has_air(array):
        note(f"{source}: shows no air (-1000 HU); it is taken as cropped within the body, and what is outside as air")


def _thinned(array: np.ndarray) -> np.ndarray:
    step = max(1, int(np.ceil((array.size / MOST_VOXELS) ** (1 / 3))))
    return array[tuple(slice(None, None, min(step, max(1, n // 8))) for n in array.shape)]


def _values(array: np.ndarray) -> _Values:
    looked_at = _thinned(array)
    lowest, highest = float(array.min()), float(array.max())
    rest = looked_at.ravel()
    if lowest < BELOW_AIR_HU and np.count_nonzero(rest == lowest) > PADDING * rest.size:
        rest = rest[rest != lowest]
    return _Values(looked_at, lowest, highest, rest, _is_noise_free(looked_at))


def _is_noise_free(array: np.ndarray) -> bool:
    """Whether most neighbours are equal, apart from those with the most frequent value or one at an end."""
    values, counts = np.unique(array, return_counts=True)
    apart = ~np.isin(array, [values[0], values[-1], values[counts.argmax()]])
    both = apart[..., 1:] & apart[..., :-1]
    if not both.any():
        return len(values) < 100
    return bool((array[..., 1:] == array[..., :-1])[both].mean() > NOISE_FREE)


def _without_hu(seen: _Values) -> str | None:
    """A line about a range that is not that of HU."""
    if not seen.values.size:
        return None
    low, high = (float(one) for one in np.percentile(seen.values, TAILS))
    given = f"values go from {seen.lowest:.3g} to {seen.highest:.3g}, so these are not HU"
    air, body, explained = _levels(seen.values)
    if 0 <= seen.lowest and seen.highest <= LARGEST_LABEL and seen.noise_free:
        values = np.unique(seen.array)
        if len(values) == 1:
            return f"has the same value everywhere ({values[0]:g})"
        if (values == np.rint(values)).all():
            return (
                f"has {len(values)} different whole numbers up to {seen.highest:g}, as a label map or mask: give the CT"
            )
    if max(-low, high) < LARGEST_NORMALIZED:
        if seen.lowest in (-1, 0) and seen.highest == 1:
            return f"{given}; they were scaled to {seen.lowest:g} to 1: take the CT before scaling"
        if -1.15 < air < -0.85 and -0.3 < body < 0.4:
            return f"{given}; perhaps HU / 1000: multiply by 1000"
        if -air > 0.2 * (body - air):  # air in mu is 0
            return f"{given}; perhaps normalized by mean and SD: take the CT before that, or give value * SD + mean"
        return f"{given}; perhaps attenuation mu: give 1000 (mu / mu_water - 1)"
    if seen.lowest > 0 and explained > SEPARATE and _ends_at_zero(seen, body):
        return f"{given}; perhaps magnitudes, as of MR, or HU + 1024: take a CT in HU"
    if seen.lowest < 0 or (seen.lowest > 0 and _is_crop_of_tissue(seen, body, explained)):
        return None
    if seen.highest <= 255:
        return f"{given}; perhaps grey values of a picture (8 bits): take the CT itself"
    if seen.highest > 2**15:
        return f"{given}; perhaps negative HU stored without a sign: subtract 65536 from values above 32767"
    return "has no value below 0, so these are not HU; perhaps HU + 1024: subtract 1024 first"


def _is_crop_of_tissue(seen: _Values, upper: float, explained: float) -> bool:
    """Whether values above 0 can be HU: soft tissue, and perhaps bone, without air or fat."""
    soft = float(np.median(seen.values)) < HIGHEST_SOFT_HU
    one_level = explained < SEPARATE
    return soft and (one_level or (seen.highest > 255 and not _between(upper, OFFSET_TISSUE)))


def _ends_at_zero(seen: _Values, upper: float) -> bool:
    """Whether values in the lower of two levels are all above 0, though normal noise around it would go below."""
    below = seen.values[seen.values < upper / 2]
    if not below.size or seen.noise_free:
        return False
    level = float(np.median(below))
    return level < NORMAL_NOISE * 1.4826 * float(np.median(np.abs(below - level)))  # the SD of normal noise by its MAD


def _shifted(seen: _Values) -> str | None:
    """A line about levels that are elsewhere than in HU: of air, and of what is denser."""
    if not seen.values.size:
        return None
    padding = seen.array.size - seen.values.size
    if padding and np.count_nonzero(seen.values > HU_BODY) < LEAST_DENSE * seen.values.size:
        return (
            f"apart from {seen.lowest:g} nothing in it is denser than {HU_BODY:g}; perhaps HU - 1000 or HU - 1024: add "
            "that first"
        )
    air, body, explained = _levels(seen.values)
    has = seen.share(*AIR_HU) > SOME_AIR and not _is_padding_only(seen)
    dense = seen.share(*OFFSET_TISSUE)
    if not has and dense > MOST_DENSE:
        given = f"{100 * dense:.0f} % of the voxels are between {OFFSET_TISSUE[0]:g} and {OFFSET_TISSUE[1]:g}"
        if np.median(_rim(seen.array)) > HU_BODY + 1000:
            return f"{given}, and they surround the rest: the values are inverted; multiply by -1"
        return f"{given}: 1000 or 1024 was added to HU; subtract it first"
    apart = body - air
    if explained > SEPARATE and CONTRAST_HU[0] < apart < CONTRAST_HU[1] and not _between(air, AIR_HU):
        # Lungs of a crop without outer air are 100 to 400 HU above air, with vessels in them.
        if air < AIR_HU[0] or (air > -400 and not has):
            shift = air - HU_AIR
            what = f"subtract {shift:.0f}" if shift > 0 else f"add {-shift:.0f}"
            return f"the air in it is at about {air:.0f}, not {HU_AIR:g} HU; {what} first"
    if explained > SEPARATE and not has and body > DENSEST_LEVEL_HU:
        upper = np.count_nonzero(seen.values > (air + body) / 2) / seen.values.size
        if upper > MOST_DENSE:
            return (
                f"{100 * upper:.0f} % of the voxels are near {body:.0f}, denser than bone, and there is no air at "
                f"{HU_AIR:g}; correct offset and slope"
            )
    if explained > SEPARATE and air < LOWEST_AIR_HU:
        return f"the air in it is at about {air:.0f}, not {HU_AIR:g} HU; correct offset and slope"
    faint = apart < FAINT_HU or (apart < FAT_HU and np.mean(_rim(seen.array) < (air + body) / 2) > ALL_AROUND)
    if explained > SEPARATE and 0 < apart and faint and not seen.noise_free:
        return (
            f"most values are near {air:.0f} or {body:.0f}; air and water in HU differ by 1000: perhaps the scale was "
            "lost (RescaleSlope, or mu per m); take the unprocessed CT"
        )
    rim = _rim(seen.array)
    rim = rim[rim >= BELOW_AIR_HU] if seen.lowest < BELOW_AIR_HU else rim
    level = float(np.median(rim)) if rim.size else HU_AIR
    if -800 < level < -250 and np.mean(np.abs(rim - level) < 100) > 0.9:
        return f"what surrounds the body is at {level:.0f} HU, where air is {HU_AIR:g}; correct offset and slope"
    return None


def _is_padding_only(seen: _Values) -> bool:
    """Whether what looks like air is one exact value at the low end, and all else, with noise, is far above it."""
    low, high = AIR_HU
    there = seen.values[(seen.values > low) & (seen.values < high)]
    same = there.size and np.count_nonzero(there == seen.lowest) > 0.99 * there.size
    return bool(same and not seen.noise_free and seen.share(high, HU_BODY) < SOME_AIR)


def _between(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def _rim(array: np.ndarray) -> np.ndarray:
    """Voxels at the border of all slices."""
    return np.concatenate([one.ravel() for one in (array[:, 0], array[:, -1], array[:, :, 0], array[:, :, -1])])


def _levels(values: np.ndarray) -> tuple[float, float, float]:
    """Split values in two (Otsu, IEEE Trans. Syst. Man Cybern. 9, 62, 1979).

    Returns
    -------
    low, high : float
        Medians of both parts.
    explained : float
        Share of the variance that the two parts explain.
    """
    low, high = np.percentile(values, TAILS)
    limited = np.clip(values, low, high)
    counts, edges = np.histogram(limited, 512)
    centres = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)
    total, moment = below[-1], np.cumsum(counts * centres)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * below / total - moment) ** 2 / (below * (total - below))
    between = np.where(np.isfinite(between), between, 0)
    best = int(between.argmax())
    variance = float(np.var(limited, dtype=np.float64))
    lower = limited <= edges[best + 1]
    if variance == 0 or lower.all():
        return float(low), float(low), 0.0
    return float(np.median(limited[lower])), float(np.median(limited[~lower])), float(between[best] / variance)


def _range(seen: _Values) -> Iterator[str]:
    """Lines about values that were clipped, or set to one value outside of the body."""
    if max(-seen.lowest, seen.highest) < LARGEST_NORMALIZED or not seen.values.size or seen.lowest >= 0:
        return  # not HU at all, which `_without_hu` reports
    at_low = np.count_nonzero(seen.array == seen.lowest) / seen.array.size
    lowest_is_tissue = seen.lowest > AIR_HU[1]
    if lowest_is_tissue and at_low > CLIPPED_LOW:
        if (seen.lowest < LOWEST_TISSUE_HU) if seen.noise_free else _spike(seen, seen.lowest, SPIKE_NEAR):
            yield (
                f"{100 * at_low:.0f} % of the voxels are exactly {seen.lowest:g}, the lowest value: it was clipped to "
                "a display window, and its air is lost; take the unprocessed CT"
            )
            return
    if seen.noise_free:
        return
    values, counts = np.unique(seen.values, return_counts=True)
    most = float(values[counts.argmax()])
    share = counts.max() / seen.array.size
    if most > AIR_HU[1] and share > MASKED and seen.lowest < most < seen.highest and _spike(seen, most, MASKED_NEAR):
        yield (
            f"{100 * share:.0f} % of the voxels are exactly {most:g}: what is outside of the body was set to it; set "
            f"it to {HU_AIR:g}"
        )
    body = np.count_nonzero(seen.values > HU_BODY)
    at_high = np.count_nonzero(seen.values == seen.highest)
    if (
        HU_BODY < seen.highest < HIGHEST_CLIP_HU
        and at_high > CLIPPED_HIGH * body
        and _spike(seen, seen.highest, SPIKE_NEAR)
    ):
        yield (
            f"{100 * at_high / body:.1f} % of the body's voxels are exactly {seen.highest:g}, the highest value: it "
            "was clipped to a display window; take the unprocessed CT"
        )


def _spike(seen: _Values, value: float, reach: float) -> bool:
    """Whether far more voxels have a value than have values within reach of it."""
    around = np.abs(seen.values - value)
    near = np.count_nonzero((around > 0) & (around <= reach))
    width = reach if value in (seen.lowest, seen.highest) else 2 * reach
    return np.count_nonzero(around == 0) > SPIKE * max(near / width, 1)


def _lengths(array: np.ndarray, grid: Grid) -> Iterator[str]:
    """The one line about lengths that are not in mm."""
    small, large = min(grid.spacing), max(grid.spacing)
    wide = grid.extent_mm[1:]
    if max(wide) > WIDEST_MM:
        yield f"is {max(wide):.3g} mm wide, where up to {WIDEST_MM:g} mm are expected; are its lengths in mm?"
    elif small < VOXEL_MM[0] or large > VOXEL_MM[1]:
        size = " x ".join(f"{one:.3g}" for one in grid.spacing[::-1])
        yield f"has voxels of {size} mm (x, y, z); are its lengths in mm?"
    elif _is_identity(grid):
        yield (
            "has voxels of 1 x 1 x 1 mm with the first at (0, 0, 0), as files have whose voxel size was lost; write "
            "the CT's affine into it, and into files of its regions"
        )
    elif max(wide) < NARROWEST_VIEW_MM and 0 < (body := _width_mm(array, grid)) < NARROWEST_BODY_MM:
        yield (
            f"is {max(wide):.3g} mm wide and the body in it {body:.3g} mm, where at least {NARROWEST_BODY_MM:g} mm are "
            "expected; are its lengths in mm, not in cm?"
        )


def _is_identity(grid: Grid) -> bool:
    """Whether the affine is that of no information, up to the signs of its axes."""
    corners = (abs(abs(c) - (n - 1) / 2) < 1e-3 for c, n in zip(grid.centre_mm, grid.shape[::-1], strict=True))
    return all(abs(one - 1) < 1e-6 for one in grid.spacing) and all(corners)


def _width_mm(array: np.ndarray, grid: Grid) -> float:
    """How wide what is denser than HU_BODY is in-plane, at its widest; 0 if it fills the image, or there is none."""
    dense = (array > HU_BODY).any(axis=0)
    spans = [np.flatnonzero(dense.any(axis=axis)) for axis in (1, 0)]
    pixels = [int(one[-1] - one[0]) + 1 if one.size else 0 for one in spans]
    if pixels == list(dense.shape):
        return 0.0
    return max(n * wide for n, wide in zip(pixels, grid.spacing[1:], strict=True))
