"""Effects that can be hidden, with their strengths in the settings of the simulator.

Ranges follow from the change of the readings in the scans of the suite (docs/validation/blind-validation.md), not from
results of the diagnosis.
"""

from __future__ import annotations

import numpy as np

from ...physics.effect import names
from .hidden_effect import (
    CONSTANT_ALONG_Z,
    EQUATIONS,
    IMAGE,
    MEAN,
    MODULE_SHARE,
    NOISE,
    READOUT_KEV,
    ROUND,
    HiddenEffect,
    sign,
)
from .missing_effects import MISSING_EFFECTS

XCIST, GVXR = SIMULATORS = ("xcist", "gvirtualxray")
COLLIMATOR_MM = 200.0  # distance from the focal spot, as the diagnosis assumes
AT_PHOTONS = 1e5  # per pixel in air, at which a saturation loses its share


def _same(setting: str, parameter: str | None = None, signed: bool = False):
    """Return a function that makes one setting, and the library's parameter with the same definition, if any."""

    def make(size, random):
        value = size * (sign(random) if signed else 1.0)
        return {setting: value}, {} if parameter is None else {parameter: value}

    return make


def _velocity(setting: str, weights: tuple[float, ...] = (1.0, 1.0, 1.0)):
    """Return a function that makes a mean velocity in a random direction, whose components have these weights."""

    def make(size, random):
        direction = random.normal(size=3) * weights
        return {setting: tuple((size * direction / np.linalg.norm(direction)).tolist())}, {}

    return make


def _wave(setting: str):
    """Return a function that makes the amplitudes of a cosine and a sine, with a random phase."""

    def make(size, random):
        phase = float(random.uniform(0, 2 * np.pi))
        return {setting: (float(size * np.cos(phase)), float(size * np.sin(phase)))}, {}

    return make


def _spectrum(size, random):
    kvp = float(random.choice([80, 100, 120, 140]))
    # Beam hardening decreases with filtration: the size is inverse to the thickness of the aluminum filter.
    return {"kvp": kvp, "aluminium_mm": 20 / size}, {"kvp": kvp}


def _focal_spot(size, random):
    length = size * float(random.uniform(0.6, 1.0))
    return {"focal_spot_mm": (size, length)}, {"width_mm": size, "length_mm": length}


def _crosstalk(setting):
    def make(size, random):
        row = size * float(random.uniform(0.5, 1.0))
        return {setting: (size, row)}, {"column": size, "row": row, "tail": 0.0}

    return make


def _bowtie(size, random):
    return {"bowtie": str(random.choice(["small", "medium", "large"])), "bowtie_scale": size}, {}


def _heel(size, random):
    depth_mm = size * sign(random)
    return {"heel_depth_mm": depth_mm}, {}  # the mean of several depths, which the library lacks


def _afterglow(size, random):
    constant = float(random.uniform(6, 14))  # ms, around the 10 of XCIST's example
    comparable = {"share": size, "time_constant_ms": constant, "before": 0.0}  # the scans begin without afterglow
    return {"lag_share": size, "lag_ms": constant}, comparable


def _source_distance(size, random):
    isocentre, detector = size * sign(random), 0.5 * size * float(random.uniform(-1, 1))
    return {"isocentre_mm": isocentre, "detector_mm": detector}, {"isocentre_mm": isocentre, "detector_mm": detector}


def _glare(size, random):
    width = float(random.uniform(20, 40))
    # The simulated signal continues beyond the detector.
    return {"glare_share": size, "glare_range_mm": width}, {"share": size, "width_mm": width, "beyond": 1.0}


def _dark(size, random):
    drift = size * float(random.uniform(-0.5, 0.5))
    settings = {"dark_photons": size, "dark_photons_per_s": drift}
    return settings, {"level_units": size * READOUT_KEV}  # the mean of all pixels


def _gains(size, _):
    # The constants of the library are independent, as errors of pixels are here, but not those of modules.
    return {"gain_rms": size}, {"rms": size * (1 - MODULE_SHARE) ** 0.5}


def _hu(size, random):
    scale, offset = 1 + size * sign(random), 500 * size * sign(random)
    return {"hu_scale": scale, "hu_offset": offset}, {"scale": scale, "offset_hu": offset}


def _off_focal(size, random):
    # Full width at half maximum of a Gaussian; the source in the library is uniform.
    width = float(random.uniform(15, 30))
    settings = {"off_focal_share": size, "off_focal_width_mm": width, "off_focal_collimator_mm": COLLIMATOR_MM}
    return settings, {"share": size}


def _saturation(size, random):
    return {"saturation_per_photon": size / AT_PHOTONS}, {}


def _wobble(size, random):
    side = size * sign(random)
    # The spot of the simulator alternates between +side and -side.
    return {"wobble_mm": side}, {"columns_mm": 2 * side, "rows_mm": 0.0}


CATALOGUE: dict[str, HiddenEffect] = {
    "spectrum": HiddenEffect(((1.0, 1.5), (2.5, 4.0), (5.0, 8.0)), _spectrum, MEAN, "haze"),
    "scatter": HiddenEffect(((0.3, 0.6), (1.5, 3.0), (5.0, 10.0)), _same("scatter_scale"), MEAN, "haze"),
    "veiling_glare": HiddenEffect(((0.002, 0.004), (0.01, 0.02), (0.03, 0.06)), _glare, MEAN, "haze"),
    "dark_signal": HiddenEffect(((20, 40), (100, 200), (400, 800)), _dark, MEAN, "haze"),
    "focal_spot": HiddenEffect(((1.0, 1.3), (1.8, 2.3), (3.0, 3.8)), _focal_spot, MEAN, "blur"),
    "xray_crosstalk": HiddenEffect(((0.005, 0.01), (0.02, 0.04), (0.08, 0.12)), _crosstalk("crosstalk"), MEAN, "blur"),
    "optical_crosstalk": HiddenEffect(
        ((0.005, 0.01), (0.02, 0.04), (0.08, 0.12)),
        _crosstalk("optical_crosstalk"),
        (*MEAN, "noise correlation"),
        "blur",
    ),
    "afterglow": HiddenEffect(((0.005, 0.01), (0.02, 0.04), (0.08, 0.15)), _afterglow, MEAN),
    "electronic_noise": HiddenEffect(
        ((12, 16), (25, 40), (80, 150)), _same("electronic_photons", "photons"), NOISE, "noise"
    ),
    "photon_flux": HiddenEffect(
        ((0.85, 0.9), (0.65, 0.75), (0.35, 0.5)), _same("flux_factor", "factor"), (*NOISE, "alignment"), "noise"
    ),
    "current_modulation": HiddenEffect(((0.1, 0.15), (0.25, 0.35), (0.5, 0.6)), _wave("modulation"), NOISE),
    "bowtie": HiddenEffect(((0.05, 0.1), (0.2, 0.4), (0.7, 1.0)), _bowtie, (*NOISE, "white field")),
    "heel": HiddenEffect(((1e-3, 2e-3), (4e-3, 7e-3), (0.012, 0.02)), _heel, (*NOISE, "white field")),
    "gain_pattern": HiddenEffect(((6e-4, 1e-3), (2e-3, 4e-3), (8e-3, 0.015)), _gains, ("pixels", "columns")),
    "centre_of_rotation": HiddenEffect(
        ((0.05, 0.08), (0.15, 0.3), (0.6, 1.2)), _same("axis_shift_mm", "shift_mm", True), MEAN, "place"
    ),
    "detector_offset": HiddenEffect(
        ((0.03, 0.05), (0.1, 0.2), (0.4, 0.8)), _same("detector_columns_px", "columns_px", True), MEAN, "place"
    ),
    "source_distance": HiddenEffect(((0.6, 1.0), (2.0, 4.0), (8.0, 15.0)), _source_distance, (*MEAN, "alignment")),
    "motion": HiddenEffect(
        ((0.1, 0.2), (0.4, 0.8), (1.5, 3.0)),
        _velocity("velocity_mm_per_s", (1.0, 1.0, 0.5)),
        MEAN,
        "drift",
    ),
    # Not comparable: the library blurs in addition to its interpolation.
    "reconstruction_kernel": HiddenEffect(
        ((0.75, 0.85), (0.9, 1.0), (1.1, 1.2)), _same("kernel_pixels"), IMAGE, of_images=True
    ),
    "hu_calibration": HiddenEffect(((0.005, 0.01), (0.02, 0.03), (0.05, 0.08)), _hu, IMAGE, of_images=True),
    "off_focal_radiation": HiddenEffect(
        ((0.01, 0.02), (0.04, 0.06), (0.1, 0.15)), _off_focal, (*MEAN, "white field"), "haze"
    ),
    "view_blur": HiddenEffect(
        ((0.2, 0.3), (0.5, 0.6), (0.9, 1.0)),
        lambda size, _: ({"duty": size, "subviews": 8}, {"duty": size}),
        MEAN,
        "blur",
        unseen=ROUND,
    ),
    "detector_saturation": HiddenEffect(
        ((0.002, 0.004), (0.01, 0.02), (0.04, 0.08)), _saturation, (*MEAN, "alignment"), "haze"
    ),
    "focal_spot_wobble": HiddenEffect(((0.1, 0.2), (0.4, 0.6), (1.0, 1.5)), _wobble, MEAN),
    "detector_row_offset": HiddenEffect(
        ((0.5, 0.8), (1.5, 2.5), (5.0, 8.0)),
        _same("detector_rows_mm", "rows_mm", True),
        MEAN,
        unseen=CONSTANT_ALONG_Z,
    ),
    "source_drift": HiddenEffect(
        ((0.1, 0.2), (0.5, 1.0), (2.0, 4.0)),
        _velocity("source_mm_per_s"),
        MEAN,
        "drift",
    ),
    "view_angle_error": HiddenEffect(
        ((0.02, 0.04), (0.1, 0.2), (0.4, 0.8)), _wave("angle_wave_deg"), MEAN, unseen=ROUND
    ),
} | MISSING_EFFECTS

SIMULATED, OTHER, OWN = EQUATIONS
OF_GEOMETRY = (
    "focal_spot",
    "source_distance",
    "view_blur",
    "focal_spot_wobble",
    "detector_offset",
    "detector_row_offset",
)
OF_SIMULATOR = {
    XCIST: (
        *OF_GEOMETRY,
        *("spectrum", "scatter", "xray_crosstalk", "optical_crosstalk", "afterglow", "electronic_noise", "photon_flux"),
        *("bowtie", "k_edge_filter"),
    ),
    GVXR: (*OF_GEOMETRY, "spectrum"),
}
# A displaced axis, a linear scale, Gaussian noise and the number of photons have one equation only. The glare is that
# of the same publication.
OWN_EQUATION = {
    XCIST: ("centre_of_rotation", "hu_calibration", "veiling_glare"),
    GVXR: ("centre_of_rotation", "hu_calibration", "veiling_glare", "electronic_noise", "photon_flux"),
}
NOT_SIMULATED = {XCIST: (), GVXR: ("bowtie", "off_focal_radiation", "k_edge_filter")}
# Not comparable with the library: crosstalk that is not geometric, and several decay times.
DEFINED_OTHERWISE = {XCIST: (), GVXR: ("xray_crosstalk", "optical_crosstalk", "afterglow")}


def equation(name: str, simulator: str) -> str:
    """Return the origin of the equation of an effect, one of EQUATIONS."""
    if name in OF_SIMULATOR[simulator]:
        return SIMULATED
    return OWN if name in OWN_EQUATION[simulator] else OTHER


def simulated_by(name: str, simulator: str) -> bool:
    """Return whether a simulator can hide an effect."""
    return name not in NOT_SIMULATED[simulator]


# Effects by the origin of their equation in scans by XCIST.
MODELS: dict[str, list[str]] = {
    origin: [name for name in CATALOGUE if equation(name, XCIST) == origin] for origin in EQUATIONS
}


def never_hidden() -> list[str]:
    """List the effects of the library that cannot be hidden, so that the blind validation does not test them.

    XCIST's projector of voxels could not rotate a flat detector: at a roll of 4 degrees, the shadow of a ball nearly
    vanished. Its projector of surfaces was not tried.
    """
    return [name for name in names() if name not in CATALOGUE]
