"""Properties of images that tables of features are diagnosed by: each alone is changed in the simulated images.

Some are effects of the library (`physics`), applied to the images; others are properties of an image that no single
effect stands for. Strengths are steps between which features are interpolated (`responses`); of the HU calibration
they are fitted to the means of the regions, apart for every fold, so that the regions left out do not enter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...base.errors import InputError
from ...base.geometry import Grid
from ...features import variants
from ...features.extraction import extract_repeats
from ...physics.effect import load, names
from ...physics.image import with_effects
from ...statistics.attribution import BASELINE
from ...statistics.comparison import MINIMUM_ROIS
from .simulated_variants import MEAN, SIGMAS_VOXELS, sampled

FOLDS = (1, 2)  # halves of the regions: strengths are fitted to one and judged on the other
EVERY_FOLD = 0  # of rows that both folds share
FLUX_FACTORS = (0.25, 0.5, 2.0, 4.0)  # of the photons that are simulated; between them strengths are interpolated
TEXTURE_SIGMAS_VOXELS = (*SIGMAS_VOXELS, 1.4, 2.0)  # a scanner's noise may be as coarse in these larger voxels
THICKNESSES_SLICES = (1.5, 2.0, 3.0)  # that are simulated; between them strengths are interpolated
SQUARE, LOGARITHM, LINEAR = (np.square, np.sqrt), (np.log, np.exp), (np.asarray, np.asarray)


@dataclass(frozen=True)
class Property:
    """One thing that may differ.

    Attributes
    ----------
    name : str
        Of an effect of the library where there is one.
    physics : str
        What happens, in a sentence.
    settled_by : str
        The further recording that shows it alone.
    parameter : tuple of (str, str), or None
        Its strength's name and unit; None where it is there or not.
    neutral : callable
        Strength that changes nothing, given the grid.
    axis : tuple of 2 callable
        (function, inverse): features are interpolated linearly in the function of the strength.
    """

    name: str
    physics: str
    settled_by: str
    parameter: tuple[str, str] | None
    neutral: Callable[[Grid], float]
    axis: tuple[Callable, Callable] = LINEAR

    @property
    def is_effect(self) -> bool:
        """Whether the library has it as an effect, so that the study can be run with it."""
        return self.name in names()


def _effect(name: str, parameter: tuple[str, str] | None, neutral: Callable[[Grid], float], axis=LINEAR) -> Property:
    effect = load(name)
    return Property(name, effect.physics, effect.settled_by, parameter, neutral, axis)


def properties() -> tuple[Property, ...]:
    """All that are tried."""
    return (
        _effect("photon_flux", ("factor", "1"), lambda grid: 1.0, LOGARITHM),
        _effect("reconstruction_kernel", ("sigma_mm", "mm"), lambda grid: 0.0, SQUARE),
        _effect("slice_thickness", ("thickness_mm", "mm"), lambda grid: grid.spacing[0]),
        _effect("hu_calibration", None, lambda grid: 0.0),
        Property(
            "noise_texture",
            "The noise is coarser, its amplitude and the object as sharp as before.",
            "noise power spectrum from repeated images of a homogeneous object",
            ("sigma_voxels", "voxels"),
            lambda grid: 0.0,
            SQUARE,
        ),
        Property(
            "resolution",
            "The object is less sharp under the same noise: blurred before the noise arises, as by focal spot or "
            "X-ray crosstalk, or smoother than the phantom.",
            "images of a wire or an edge; projections of it tell blur before the noise from the kernel",
            ("sigma_voxels", "voxels"),
            lambda grid: 0.0,
            SQUARE,
        ),
        Property(
            "voxels",
            "The voxels have another size: no physics of the scan, but most textures count them.",
            "the same scan simulated, or reconstructed, on the other's voxels",
            None,
            lambda grid: 0.0,
        ),
    )


def folds(rois: Mapping[str, str]) -> dict[str, int]:
    """Folds of ROIs, alternately by tissue class and name, so that classes of several ROIs are in both.

    Parameters
    ----------
    rois : mapping of str to str
        {name: tissue class}.

    Returns
    -------
    dict of str to int
        {ROI: its fold}.

    Raises
    ------
    InputError
        For a single ROI, of which none can be held out.
    """
    if len(rois) < len(FOLDS):
        raise InputError(f"diagnosis: {len(rois)} ROI to compare; holding one out needs at least {len(FOLDS)}")
    order = sorted(rois, key=lambda roi: (rois[roi], roi))
    return {roi: FOLDS[index % len(FOLDS)] for index, roi in enumerate(order)}


def calibration(simulated: np.ndarray, recorded: np.ndarray) -> dict[str, float]:
    """Scale and offset that bring simulated means of regions to those recorded, by least squares.

    Of fewer than three regions the offset alone, the scale being 1. Both keep to the effect's plausible range.

    Parameters
    ----------
    simulated, recorded : ndarray, shape (regions,)
        HU.

    Returns
    -------
    dict of str to float
        scale and offset_hu, HU.
    """
    ranges = {one.name: (one.low, one.high) for one in load("hu_calibration").parameters}
    scale = 1.0
    if len(simulated) >= MINIMUM_ROIS and np.ptp(simulated) > 0:
        scale = float(np.clip(np.polyfit(simulated, recorded, 1)[0], *ranges["scale"]))
    offset = float(np.clip((recorded - scale * simulated).mean(), *ranges["offset_hu"]))
    return {"scale": scale, "offset_hu": offset}


def property_tables(
    images: np.ndarray,
    grid: Grid,
    masks: Mapping[str, np.ndarray],
    fold_of: Mapping[str, int],
    recorded: pd.DataFrame,
    voxel_mm: Sequence[float] | None = None,
) -> Iterator[pd.DataFrame]:
    """Features of the images as they are (BASELINE) and with every property changed.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        Repeats of one protocol and noise level, HU.
    grid : Grid
    masks : mapping of str to ndarray of bool, shape (z, y, x)
        By ROI.
    fold_of : mapping of str to int
        From `folds`.
    recorded : DataFrame
        Features of the recording in HU, one row per image and ROI.
    voxel_mm : sequence of 3 float, optional
        (z, y, x) of the recording, mm; None leaves `voxels` out.

    Yields
    ------
    DataFrame
        A table per strength. Columns: property, strength, fold (EVERY_FOLD, or of the ROIs that a calibration was
        fitted to), then those of extraction.extract; rows are repeats in order, each with all ROIs.
    """

    def table(name, strength, fold, changed, on=grid, within=masks):
        found = extract_repeats(changed, on, within, name)
        front = pd.DataFrame({"property": name, "strength": strength, "fold": fold}, index=found.index)
        return pd.concat([front, found], axis=1).reset_index(drop=True)

    def effect(name, **values):
        return np.stack([with_effects(image, grid.spacing, {name: values}) for image in images])

    mean, noise = variants.split(images)
    within = np.any(list(masks.values()), axis=0)
    baseline = table(BASELINE, 0.0, EVERY_FOLD, images)
    yield baseline
    for factor in FLUX_FACTORS:
        yield table("photon_flux", factor, EVERY_FOLD, variants.scale_noise(mean, noise, factor**-0.5))
    for sigma in TEXTURE_SIGMAS_VOXELS:
        yield table("noise_texture", sigma, EVERY_FOLD, variants.filter_noise(mean, noise, sigma, within))
    for sigma in SIGMAS_VOXELS:
        yield table("resolution", sigma, EVERY_FOLD, variants.blur(mean, noise, sigma))
        sigma_mm = sigma * grid.spacing[2]
        yield table("reconstruction_kernel", sigma_mm, EVERY_FOLD, effect("reconstruction_kernel", sigma_mm=sigma_mm))
    for slices in THICKNESSES_SLICES:
        thickness = slices * grid.spacing[0]
        yield table("slice_thickness", thickness, EVERY_FOLD, effect("slice_thickness", thickness_mm=thickness))
    ours, theirs = (one.groupby("roi")[MEAN].mean() for one in (baseline, recorded))
    for fold in FOLDS:
        chosen = [roi for roi in masks if fold_of[roi] == fold]
        values = calibration(ours[chosen].to_numpy(), theirs[chosen].to_numpy())
        yield table("hu_calibration", 1.0, fold, effect("hu_calibration", **values))
    if voxel_mm is not None:
        yield table("voxels", 1.0, EVERY_FOLD, *sampled(images, grid, masks, voxel_mm))
