"""What can be concealed: every effect with its strengths, in the simulator's own settings.

Ranges were set from the change of the readings of the suite's scans (docs/validation/blind-validation.md), not from
results of the diagnosis.
"""

from __future__ import annotations

import numpy as np

from ...physics.effect import names
from .concealable import IMAGE, MEAN, NOISE, STRENGTHS, Concealable, ranges, sign
from .lacking import LACKING
from .objects import READOUT_KEV

__all__ = ["CATALOGUE", "IMAGE", "MODELS", "STRENGTHS", "XCIST", "Concealable", "never_concealed"]

COLLIMATOR_MM = 200.0  # of the scanner, from the focal spot, as the diagnosis takes it to be
AT_PHOTONS = 1e5  # per pixel in air, of which a saturation takes the share that it is told by


def _same(setting: str, parameter: str, signed: bool = False):
    """One number that simulator and library define alike."""

    def make(size, random):
        value = size * (sign(random) if signed else 1.0)
        return {setting: value}, {parameter: value}

    return make


def _spectrum(size, random):
    kvp = float(random.choice([80, 100, 120, 140]))
    # Hardening shrinks as filtration grows: the size is that of the filter, in mm of aluminium, inverted.
    return {"kvp": kvp, "aluminium_mm": 20 / size}, {"kvp": kvp}


def _scatter(size, random):
    return {"scatter_scale": size}, {}


def _focal_spot(size, random):
    length = size * float(random.uniform(0.6, 1.0))
    return {"focal_spot_mm": (size, length)}, {"width_mm": size, "length_mm": length}


def _crosstalk(setting):
    def make(size, random):
        row = size * float(random.uniform(0.5, 1.0))
        return {setting: (size, row)}, {"column": size, "row": row}

    return make


def _bowtie(size, random):
    return {"bowtie": str(random.choice(["small", "medium", "large"])), "bowtie_scale": size}, {}


def _modulation(size, random):
    phase = float(random.uniform(0, 2 * np.pi))
    cosine, sine = size * np.cos(phase), size * np.sin(phase)
    return {"modulation": (cosine, sine)}, {"cosine": cosine, "sine": sine}


def _heel(size, random):
    depth_mm = size * sign(random)
    # The library's anode is on the side that its angle says; the simulator's positive depth has it on the other.
    return {"heel_depth_mm": depth_mm}, {"depth_um": -1000 * depth_mm}


def _afterglow(size, random):
    constant = float(random.uniform(6, 14))  # ms, around the 10 of XCIST's example
    comparable = {"share": size, "time_constant_ms": constant, "before": 0.0}  # its scans begin without a glow
    return {"lag_share": size, "lag_ms": constant}, comparable


def _source_distance(size, random):
    isocentre, detector = size * sign(random), 0.5 * size * float(random.uniform(-1, 1))
    return {"isocentre_mm": isocentre, "detector_mm": detector}, {"isocentre_mm": isocentre, "detector_mm": detector}


def _motion(size, random):
    direction = random.normal(size=3) * (1.0, 1.0, 0.5)
    velocity = (size * direction / np.linalg.norm(direction)).tolist()
    names = ("x_mm_per_s", "y_mm_per_s", "z_mm_per_s")
    return {"velocity_mm_per_s": tuple(velocity)}, dict(zip(names, velocity, strict=True))


def _glare(size, random):
    return {"glare_share": size, "glare_range_mm": float(random.uniform(20, 40))}, {}


def _dark(size, random):
    drift = size * float(random.uniform(-0.5, 0.5))
    settings = {"dark_photons": size, "dark_photons_per_s": drift}
    return settings, {"level_units": size * READOUT_KEV, "drift_units_per_s": drift * READOUT_KEV}


def _kernel(size, random):
    return {"kernel_pixels": size}, {}  # the library's blurs on top of its own interpolation


def _hu(size, random):
    scale, offset = 1 + size * sign(random), 500 * size * sign(random)
    return {"hu_scale": scale, "hu_offset": offset}, {"scale": scale, "offset_hu": offset}


def _off_focal(size, random):
    # A Gaussian's full width at half maximum; the library's source is even.
    width = float(random.uniform(15, 30))
    settings = {"off_focal_share": size, "off_focal_width_mm": width, "off_focal_collimator_mm": COLLIMATOR_MM}
    return settings, {"share": size}


def _saturation(size, random):
    """Half of them lose readings in proportion to what arrives; half read a power of it."""
    if random.random() < 0.5:
        return {"saturation_per_photon": size / AT_PHOTONS}, {}
    exponent = 1 + size * sign(random)
    return {"reading_power": exponent}, {"exponent": exponent}


def _wobble(size, random):
    side = size * sign(random)
    # The simulator's spot lies on one side by so much, and then on the other.
    return {"wobble_mm": side}, {"columns_mm": 2 * side, "rows_mm": 0.0}


def _source_drift(size, random):
    direction = random.normal(size=3)
    velocity = (size * direction / np.linalg.norm(direction)).tolist()
    names = ("columns_mm_per_s", "rows_mm_per_s", "away_mm_per_s")
    return {"source_mm_per_s": tuple(velocity)}, dict(zip(names, velocity, strict=True))


def _angle_wave(size, random):
    phase = float(random.uniform(0, 2 * np.pi))
    cosine, sine = size * np.cos(phase), size * np.sin(phase)
    return {"angle_wave_deg": (cosine, sine)}, {"cosine_deg": cosine, "sine_deg": sine}


CATALOGUE: dict[str, Concealable] = {
    "spectrum": Concealable(True, ranges((1.0, 1.5), (2.5, 4.0), (5.0, 8.0)), _spectrum, MEAN, "haze"),
    "scatter": Concealable(True, ranges((0.3, 0.6), (1.5, 3.0), (5.0, 10.0)), _scatter, MEAN, "haze"),
    "veiling_glare": Concealable(True, ranges((0.002, 0.004), (0.01, 0.02), (0.03, 0.06)), _glare, MEAN, "haze"),
    "dark_signal": Concealable(True, ranges((20, 40), (100, 200), (400, 800)), _dark, MEAN, "haze"),
    "focal_spot": Concealable(True, ranges((1.0, 1.3), (1.8, 2.3), (3.0, 3.8)), _focal_spot, MEAN, "blur"),
    "xray_crosstalk": Concealable(
        True, ranges((0.005, 0.01), (0.02, 0.04), (0.08, 0.12)), _crosstalk("crosstalk"), MEAN, "blur"
    ),
    "optical_crosstalk": Concealable(
        True,
        ranges((0.005, 0.01), (0.02, 0.04), (0.08, 0.12)),
        _crosstalk("optical_crosstalk"),
        (*MEAN, "noise correlation"),
        "blur",
    ),
    "afterglow": Concealable(True, ranges((0.005, 0.01), (0.02, 0.04), (0.08, 0.15)), _afterglow, MEAN),
    "electronic_noise": Concealable(
        True, ranges((12, 16), (25, 40), (80, 150)), _same("electronic_photons", "photons"), NOISE, "noise"
    ),
    "photon_flux": Concealable(
        True,
        ranges((0.85, 0.9), (0.65, 0.75), (0.35, 0.5)),
        _same("flux_factor", "factor"),
        (*NOISE, "alignment"),
        "noise",
    ),
    "current_modulation": Concealable(True, ranges((0.1, 0.15), (0.25, 0.35), (0.5, 0.6)), _modulation, NOISE),
    "bowtie": Concealable(True, ranges((0.05, 0.1), (0.2, 0.4), (0.7, 1.0)), _bowtie, (*NOISE, "white field")),
    "heel": Concealable(True, ranges((1e-3, 2e-3), (4e-3, 7e-3), (0.012, 0.02)), _heel, (*NOISE, "white field")),
    "gain_pattern": Concealable(
        True, ranges((6e-4, 1e-3), (2e-3, 4e-3), (8e-3, 0.015)), _same("gain_rms", "rms"), ("pixels", "columns")
    ),
    "centre_of_rotation": Concealable(
        True, ranges((0.05, 0.08), (0.15, 0.3), (0.6, 1.2)), _same("axis_shift_mm", "shift_mm", True), MEAN, "place"
    ),
    "detector_offset": Concealable(
        True,
        ranges((0.03, 0.05), (0.1, 0.2), (0.4, 0.8)),
        _same("detector_columns_px", "columns_px", True),
        MEAN,
        "place",
    ),
    "source_distance": Concealable(
        True, ranges((0.6, 1.0), (2.0, 4.0), (8.0, 15.0)), _source_distance, (*MEAN, "alignment")
    ),
    "motion": Concealable(True, ranges((0.1, 0.2), (0.4, 0.8), (1.5, 3.0)), _motion, MEAN, "drift"),
    "reconstruction_kernel": Concealable(
        True, ranges((0.75, 0.85), (0.9, 1.0), (1.1, 1.2)), _kernel, IMAGE, of_images=True
    ),
    "hu_calibration": Concealable(True, ranges((0.005, 0.01), (0.02, 0.03), (0.05, 0.08)), _hu, IMAGE, of_images=True),
    "off_focal_radiation": Concealable(
        True, ranges((0.01, 0.02), (0.04, 0.06), (0.1, 0.15)), _off_focal, (*MEAN, "white field"), "haze"
    ),
    "view_blur": Concealable(
        True,
        ranges((0.2, 0.3), (0.5, 0.6), (0.9, 1.0)),
        lambda size, _: ({"duty": size, "subviews": 8}, {"duty": size}),
        MEAN,
        "blur",
    ),
    "detector_saturation": Concealable(
        True, ranges((0.002, 0.004), (0.01, 0.02), (0.04, 0.08)), _saturation, (*MEAN, "alignment"), "haze"
    ),
    "focal_spot_wobble": Concealable(True, ranges((0.1, 0.2), (0.4, 0.6), (1.0, 1.5)), _wobble, MEAN),
    "detector_row_offset": Concealable(
        True, ranges((0.5, 0.8), (1.5, 2.5), (5.0, 8.0)), _same("detector_rows_mm", "rows_mm", True), MEAN
    ),
    "source_drift": Concealable(True, ranges((0.1, 0.2), (0.5, 1.0), (2.0, 4.0)), _source_drift, MEAN, "drift"),
    "view_angle_error": Concealable(True, ranges((0.02, 0.04), (0.1, 0.2), (0.4, 0.8)), _angle_wave, MEAN),
} | LACKING

# Whose model of an effect makes the recordings.
XCIST = "XCIST's own"
OTHER = "an equation of the proof's own, which is not the library's"
REPEATED = "the library's equation, written again"
MODELS: dict[str, tuple[str, ...]] = {
    XCIST: (
        "spectrum",
        "scatter",
        "focal_spot",
        "xray_crosstalk",
        "optical_crosstalk",
        "afterglow",
        "electronic_noise",
        "photon_flux",
        "bowtie",
        "source_distance",
        "view_blur",
        "focal_spot_wobble",
        "k_edge_filter",
    ),
    OTHER: (
        "veiling_glare",
        "off_focal_radiation",
        "detector_saturation",
        *(name for name in LACKING if name != "k_edge_filter"),
    ),
    REPEATED: (
        "dark_signal",
        "current_modulation",
        "heel",
        "gain_pattern",
        "centre_of_rotation",
        "detector_offset",
        "motion",
        "detector_row_offset",
        "source_drift",
        "view_angle_error",
        "reconstruction_kernel",
        "hu_calibration",
    ),
}


def never_concealed() -> list[str]:
    """Effects of the library that cannot be concealed, so that the proof says nothing of them.

    XCIST's projector of voxels cannot turn a flat detector: on one rolled by 4 degrees, a ball's shadow is nearly gone.
    """
    return [name for name in names() if name not in CATALOGUE]
