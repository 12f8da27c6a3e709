"""Properties of images that tables of features are diagnosed by: each alone is changed in the simulated images.

Some are effects of the library (`physics`), applied to the images; others are properties of an image that no single
effect stands for. Strengths are steps between which features are interpolated (`responses`); of the HU calibration
they are fitted to the means of the regions, apart for every fold, so that the regions left out do not enter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...physics.effect import load, names
from ...statistics.comparison_summary import MINIMUM_ROIS

BASELINE = "baseline"  # in tables: the images with no property changed
FOLDS = (1, 2)  # halves of the regions: strengths are fitted to one and judged on the other
EVERY_FOLD = 0  # of rows that both folds share
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
            "The noise is coarser; its amplitude and the sharpness of the object do not change.",
            "measure the noise power spectrum in repeated images of a homogeneous object",
            ("sigma_voxels", "voxels"),
            lambda grid: 0.0,
            SQUARE,
        ),
        Property(
            "resolution",
            "The object is less sharp with the same noise: it is blurred before detection, as by the focal spot or "
            "X-ray crosstalk, or smoother than the phantom.",
            "image a wire or an edge; projections distinguish blur before detection from the kernel",
            ("sigma_voxels", "voxels"),
            lambda grid: 0.0,
            SQUARE,
        ),
        Property(
            "voxels",
            "The voxels have another size. This is not physics of the scan, but most textures depend on it.",
            "simulate or reconstruct the scan on the voxels of the other one",
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
