"""Nuisance parameters of a recording with Gaussian priors: scale, offset, pose, photons and numerical errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ...base.names import label
from ...physics.scenes.scene import Pose

# Bound on the deviation from a prior, in standard deviations. If much physics is missing, a Gaussian prior alone does
# not limit the deviation.
PRIOR_BOUND_SD = 5.0
# Mean and standard deviation of a numerical error relative to the change by another discretization (L. F. Richardson,
# Philos. Trans. R. Soc. A 210, 307, 1911).
# - rays: the change by twice as many rays is expected to equal the change by all further rays.
# - voxels: voxels of edge h, with linear interpolation, blur by a variance of h^2/4. Voxels twice as large add 3/4 h^2.
#   The true object also has a blur: 0 (ratio 0.33), h^2/24 for voxels half as large (0.28), or h^2/12 for sharp
#   voxels of edge h (0.22).
# - simulation: the user's own simulation averages over its pixels in a way that is known to 3 % of this average.
NUMERICAL = {"rays": (1.0, 1 / 3), "voxels": (0.28, 0.06), "simulation": (0.0, 0.03)}
NOMINAL_PHOTONS_SD = 0.02  # of the logarithm of a stated number of photons
# Unit, expected value and default standard deviation; choices. The air offset is the drift of the tube since the air
# scan. Position and rotation are those of an object that is placed by hand.
DEFAULTS = {
    "scale": ("1", 1.0, 0.005),
    "offset": ("1", 0.0, 0.002),
    "x_mm": ("mm", 0.0, 1.0),
    "y_mm": ("mm", 0.0, 1.0),
    "z_mm": ("mm", 0.0, 1.0),
    "turn_deg": ("degrees", 0.0, 0.5),
}
LOCATION = ("x_mm", "y_mm", "z_mm")
PLACE = (*LOCATION, "turn_deg")
POSES = (*PLACE, "size")
PIECE = "piece_"  # prefix of the names of local mismatches' attenuation
# Names for texts, where they are not clear in themselves
NAMES = {
    "log_photons": "logarithm of the photons",
    "scale": "object density scale",
    "offset": "air offset",
    "size": "object size",
    "turn_deg": "object rotation",
    **{name: f"object position {name[0]}" for name in LOCATION},
}


@dataclass(frozen=True)
class Nuisance:
    """Nuisance parameter, fitted in every model, with a Gaussian prior."""

    name: str
    unit: str
    expected: float
    sd: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of a fit."""
        return self.expected - PRIOR_BOUND_SD * self.sd, self.expected + PRIOR_BOUND_SD * self.sd

    def pull(self, value: float) -> float:
        """Return the deviation of a value from the prior, in standard deviations."""
        return (value - self.expected) / self.sd


def display_name(name: str) -> str:
    """Return the name of a nuisance parameter for texts."""
    return NAMES.get(name) or label(name)


def nuisances(
    log_photons: float,
    photons_sd: float,
    known: Mapping[str, float],
    numerical: Iterable[str] = (),
    location: Mapping[str, float] | None = None,
) -> tuple[Nuisance, ...]:
    """Return the nuisance parameters of a recording of projections.

    Parameters
    ----------
    log_photons, photons_sd : float
        Logarithm of the photons per pixel in air, and its standard deviation (infinite: not known).
    known : mapping of str to float
        Standard deviations from the configuration, which replace the defaults.
    numerical : iterable of str, optional
        Names of the model's numerical errors, keys of NUMERICAL.
    location : mapping of str to float, optional
        Expected position of the object, names of PLACE; 0 for names that are not stated.
    """
    defaults = dict(DEFAULTS)
    for name, value in (location or {}).items():
        defaults[name] = (defaults[name][0], value, defaults[name][2])
    if "size" in known:  # of the object; an image states the size of its voxels
        defaults["size"] = ("1", 1.0, known["size"])
    defaults |= {name: ("1", *NUMERICAL[name]) for name in numerical}
    rest = [Nuisance(name, unit, mean, known.get(name, sd)) for name, (unit, mean, sd) in defaults.items()]
    return (Nuisance("log_photons", "1", log_photons, photons_sd), *rest)


def pose_of(nuisance: Mapping[str, float]) -> Pose:
    """Return the object's pose."""
    return Pose(**{name: nuisance[name] for name in POSES if name in nuisance})
