"""The alignment that every model gets alike: nobody's physics, held by what is known of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ...physics.scenes.scene import Pose

# Standard deviations that what is known may be off by at most: where much is left out, a Gaussian alone gives way.
SURE = 5.0
# Expected and standard deviation of numerical errors, over what a finer step changes (L. F. Richardson, Phil. Trans. R.
# Soc. A 210, 307, 1911). Twice as many rays are expected to change what all further ones do. Voxels of edge h,
# and lines between their middles, blur by a variance of h^2/4, those twice as large by 3/4 h^2 more; an object that is
# finer by itself is blurred by less, down to 0 (0.33), one of voxels half as large by h^2/24 (0.28), one of just these
# voxels, but with sharp edges, by h^2/12 (0.22).
NUMERICAL = {"rays": (1.0, 1 / 3), "voxels": (0.28, 0.06)}
NOMINAL_PHOTONS_SD = 0.02  # of the logarithm: how well a stated number of photons is taken to be known
LOCATION = ("x_mm", "y_mm", "z_mm")
PLACE = (*LOCATION, "turn_deg")
POSES = (*PLACE, "size")
PIECE = "piece_"  # begins the names of what pieces of the object attenuate more than was stated


@dataclass(frozen=True)
class Nuisance:
    """A number of the alignment: nobody's physics, fitted in every model.

    Attributes
    ----------
    expected, sd : float
        The Gaussian of what is known of it, by which it is held.
    """

    name: str
    unit: str
    expected: float
    sd: float

    def off(self, value: float) -> float:
        """How far a value lies off what is known, in its standard deviations."""
        return (value - self.expected) / self.sd


def nuisances(
    log_photons: float,
    photons_sd: float,
    known: Mapping[str, float],
    numerical: Iterable[str] = (),
    location: Mapping[str, float] | None = None,
) -> tuple[Nuisance, ...]:
    """The alignment of a recording of projections.

    Parameters
    ----------
    log_photons, photons_sd : float
        Logarithm of the photons per pixel in air, and how well it is known (infinite: not).
    known : mapping of str to float
        Standard deviations that the configuration gives instead of the defaults.
    numerical : iterable of str, optional
        Names of the model's numerical distortions, of NUMERICAL.
    location : mapping of str to float, optional
        Where the object is expected, by name of LOCATION, mm; 0 where it is not stated.
    """
    defaults = {
        "scale": ("1", 1.0, 0.005),  # of the line integrals: density of the phantom's material
        "offset": ("1", 0.0, 0.002),  # of the line integrals: drift of the tube since the air scan
        "x_mm": ("mm", 0.0, 1.0),
        "y_mm": ("mm", 0.0, 1.0),
        "z_mm": ("mm", 0.0, 1.0),
        "turn_deg": ("degrees", 0.0, 0.5),
    }
    for name, value in (location or {}).items():
        defaults[name] = ("mm", value, defaults[name][2])
    if "size" in known:  # of the object; an image states the size of its voxels
        defaults["size"] = ("1", 1.0, known["size"])
    defaults |= {name: ("1", *NUMERICAL[name]) for name in numerical}
    rest = [Nuisance(name, unit, mean, known.get(name, sd)) for name, (unit, mean, sd) in defaults.items()]
    return (Nuisance("log_photons", "1", log_photons, photons_sd), *rest)


def pose_of(nuisance: Mapping[str, float]) -> Pose:
    """The object's pose in an alignment."""
    return Pose(**{name: nuisance[name] for name in POSES if name in nuisance})
