"""Imperfections of the world of a case besides its hidden effects: object, pose, dose, and small further deviations."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from .catalogue import CATALOGUE, DEFINED_OTHERWISE
from .hidden_effect import STRENGTHS
from .objects import ScannedObject

HU_ERROR = 5.0  # largest error of the CT number of a part, HU
SHAPE_MM = (0.1, 0.3)  # error of the semi-axes of a part
SHIFT_MM, HEIGHT_MM, TURN_DEG = 0.8, 0.5, 0.4  # largest errors of the pose
DOSE_SD = 0.015  # of the logarithm of the photons
# Deviations that may be declared if the simulator defines all parameters as the library does.
DECLARABLE = ("electronic_noise", "detector_offset", "detector_row_offset", "source_distance", "xray_crosstalk")
STATED_SD = 0.1  # error of declared parameters, relative to their size
# Deviations that are not declared, in a share of the cases, with their shares of the smallest hidden size. The largest
# objects change by less than 1 HU in any square of 8 x 8 voxels, the default threshold of relevance.
SMALL = {
    **{"dark_signal": 0.04, "scatter": 0.05, "gain_pattern": 0.2, "afterglow": 0.2, "detector_offset": 0.2},
    "veiling_glare": 0.2,
}
SMALL_CASES = 0.25


def drawn(
    scanned: ScannedObject, hidden: Collection[str], count: int, random: np.random.Generator, simulator: str
) -> dict:
    """Draw the imperfections of a case.

    Parameters
    ----------
    hidden : collection of str
        Hidden effects, which are neither declared nor small deviations.
    count : int
        Largest number of declared deviations.

    Returns
    -------
    dict
        * object: HU error by part
        * shape_mm: error of the semi-axes by part
        * pose: fields of base.pose.Pose
        * flux_factor: true photons over stated ones
        * declared, undeclared: {effect: {parameter: true value}}
        * stated: {effect: {parameter: {value, sd}}}, as declared to the diagnosis
        * settings: settings of the simulator
    """
    names = [part.name for part in scanned.parts]
    errors = random.uniform(-HU_ERROR, HU_ERROR, len(names))
    sizes = random.choice([-1.0, 1.0], len(names)) * random.uniform(*SHAPE_MM, len(names))
    x, y, z, turn = random.uniform(-1, 1, 4) * (SHIFT_MM, SHIFT_MM, HEIGHT_MM, TURN_DEG)
    found = {
        "object": dict(zip(names, errors.tolist(), strict=True)),
        "shape_mm": dict(zip(names, sizes.tolist(), strict=True)),
        "pose": {"x_mm": float(x), "y_mm": float(y), "z_mm": float(z), "turn_deg": float(turn)},
        "flux_factor": float(np.exp(random.normal(0, DOSE_SD))),
        "declared": {},
        "undeclared": {},
        "stated": {},
        "settings": {},
    }
    groups = {CATALOGUE[name].alike for name in hidden} - {""}
    free = [name for name in DECLARABLE if name not in (*hidden, *DEFINED_OTHERWISE[simulator])]
    free = [name for name in free if CATALOGUE[name].alike not in groups]
    for name in random.permutation(free)[: int(random.integers(0, count + 1))]:
        settings, true = CATALOGUE[name].draw(STRENGTHS[0], random)
        found["settings"] |= settings
        found["declared"][str(name)] = true
        found["stated"][str(name)] = {key: _stated(value, random) for key, value in true.items()}
    free = [name for name in SMALL if name not in hidden and name not in found["declared"]]
    free = [name for name in free if CATALOGUE[name].alike not in groups]
    if free and random.random() < SMALL_CASES:
        name = str(random.choice(free))
        settings, true = CATALOGUE[name].make(SMALL[name] * CATALOGUE[name].ranges[0][0], random)
        found["settings"] |= settings
        found["undeclared"][name] = true
    return found


def _stated(value: float, random: np.random.Generator) -> dict[str, float]:
    sd = STATED_SD * abs(value)
    return {"value": float(value + random.normal(0, sd)), "sd": float(sd)}
