"""Image properties that are tested as explanations of feature differences, one at a time.

Some are effects of `physics` that act on images; others correspond to no single effect. Features are interpolated
between simulated strengths (`responses`). The HU calibration is fitted to the mean HU of each fold's ROIs, so that the
held-out ROIs have no influence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...physics.effect import load, names
from ...statistics.comparison_summary import MINIMUM_ROIS

BASELINE = "baseline"  # name of the unchanged images in tables
FOLDS = (1, 2)  # halves of the ROIs: strengths are fitted to one and tested on the other
EVERY_FOLD = 0  # for rows that both folds share
SQUARE, LOGARITHM, LINEAR = (np.square, np.sqrt), (np.log, np.exp), (np.asarray, np.asarray)


@dataclass(frozen=True)
class Property:
    """Image property that may differ between simulation and recording.

    Attributes
    ----------
    name : str
        Name; the name of the effect if the property is an effect.
    settled_by : str
        Further measurement that tests this property alone.
    parameter : tuple of (str, str), or None
        Name and unit of the strength; None for a property without a strength.
    neutral : callable
        Function of the grid that returns the strength without change.
    axis : tuple of 2 callable
        (function, inverse). Features are interpolated linearly in function(strength).
    """

    name: str
    physics: str
    settled_by: str
    parameter: tuple[str, str] | None
    neutral: Callable[[Grid], float]
    axis: tuple[Callable, Callable] = LINEAR

    @property
    def is_effect(self) -> bool:
        """Whether the property is an effect of `physics`, which a study can simulate."""
        return self.name in names()


def _effect(name: str, parameter: tuple[str, str] | None, neutral: Callable[[Grid], float], axis=LINEAR) -> Property:
    effect = load(name)
    return Property(name, effect.physics, effect.settled_by, parameter, neutral, axis)


def properties() -> tuple[Property, ...]:
    """Return all tested properties."""
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
            "simulate or reconstruct both scans with the same voxel size",
            None,
            lambda grid: 0.0,
        ),
    )


def folds(rois: Mapping[str, str]) -> dict[str, int]:
    """Assign ROIs to folds, alternately by tissue class and name, so that both folds have each class with two ROIs.

    Parameters
    ----------
    rois : mapping of str to str
        {name: tissue class}.

    Raises
    ------
    InputError
        For a single ROI, as none can be held out.
    """
    if len(rois) < len(FOLDS):
        raise InputError(f"diagnosis: {len(rois)} ROI to compare; holding one out needs at least {len(FOLDS)}")
    order = sorted(rois, key=lambda roi: (rois[roi], roi))
    return {roi: FOLDS[index % len(FOLDS)] for index, roi in enumerate(order)}


def calibration(simulated: np.ndarray, recorded: np.ndarray) -> dict[str, float]:
    """Fit scale and offset of simulated to recorded mean HU of ROIs by least squares, within the range of the effect.

    With fewer than three ROIs, only the offset is fitted.

    Parameters
    ----------
    simulated, recorded : ndarray, shape (regions,)
        HU.
    """
    ranges = {parameter.name: (parameter.low, parameter.high) for parameter in load("hu_calibration").parameters}
    scale = 1.0
    if len(simulated) >= MINIMUM_ROIS and np.ptp(simulated) > 0:
        scale = float(np.clip(np.polyfit(simulated, recorded, 1)[0], *ranges["scale"]))
    offset = float(np.clip((recorded - scale * simulated).mean(), *ranges["offset_hu"]))
    return {"scale": scale, "offset_hu": offset}
