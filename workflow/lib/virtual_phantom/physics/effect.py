"""What an effect is: a piece of physics that the baseline leaves out, one file each in `effects`."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from ..base.errors import InputError, meant

FOLDER = Path(__file__).parent / "effects"
# In the order in which they act.
STAGES = (
    "geometry",
    "motion",
    "spectrum",
    "fluence",
    "focal_spot",
    "scatter",
    "crosstalk",
    "noise",
    "readout",
    "image",
)


# What a parameter is counted in where one scan is asked about: the time from view to view, that of the whole scan, what
# the detector reads in air, and that over the scan's time.
PER_VIEW, PER_SCAN, OF_AIR, OF_AIR_PER_SCAN = "view interval", "scan", "air", "air over the scan"
READOUT_UNITS = (
    "readout units"  # in a study and of its own recordings photons, of line integrals alone the signal in air
)
LOGARITHM = 0  # as a power: fits vary the logarithm


@dataclass(frozen=True)
class Reach:
    """What one scan shows of a parameter whose unit carries over to others: a fit's range and start, and a typical
    strength. A motion in mm/s, say, by the mm that it amounts to over the scan.

    of   what it is counted in: PER_VIEW, PER_SCAN, OF_AIR or OF_AIR_PER_SCAN
    """

    of: str
    low: float
    high: float
    start: float
    typical: float


@dataclass(frozen=True)
class Parameter:
    """A number that an effect has, in a unit that carries over to the scanner's other scans.

    neutral     at this value the effect does nothing; None if there is none
    low, high   plausible range, which the configuration and the fit keep to
    start       where a fit begins
    typical     a strength that scanners show, for templates and examples
    power       with which power of it a small effect grows: 2 for the width of a blur. Fits vary that power, in which
                data are straighter; LOGARITHM of what may be of any size
    reach       what of it one scan shows; None: as the range, start and typical strength say
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    start: float
    typical: float
    neutral: float | None = 0.0
    power: int = 1
    reach: Reach | None = None

    def number(self, value: float) -> float:
        """What fits vary, of a value."""
        return math.log(value) if self.power == LOGARITHM else value**self.power

    @property
    def timed(self) -> bool:
        """Whether it can be told only of a scan whose times are known."""
        return self.reach is not None and self.reach.of != OF_AIR

    def within(self, scan: Mapping[str, float]) -> Parameter:
        """Itself with range, start and typical strength as one scan shows them.

        scan   {unit of Reach: how much of the parameter is 1 of it}
        """
        if self.reach is None:
            return self
        one = scan[self.reach.of]
        low, high = max(self.low, self.reach.low * one), min(self.high, self.reach.high * one)
        start, typical = (min(max(value * one, low), high) for value in (self.reach.start, self.reach.typical))
        return replace(self, low=low, high=high, start=start, typical=typical)


@dataclass(frozen=True)
class Effect:
    """One piece of physics.

    name         of its file
    physics      what happens, in a sentence
    equation     as applied
    source       where it is described
    stage        one of STAGES
    signature    what tells it apart from others
    settled_by   the further recording that shows it alone
    apply        (state, values by name): changes in place a chain.State, or at stage "image" an image.ImageState
    pattern      True if one unknown per detector pixel is fitted beside the parameters (rings)
    rank         of image effects, which act in the order of their ranks, and of their names where these are equal:
                 0 for sharpness, 1 for the numbers
    """

    name: str
    physics: str
    equation: str
    source: str
    stage: str
    signature: str
    settled_by: str
    parameters: tuple[Parameter, ...]
    apply: Callable
    pattern: bool = False
    rank: int = 0

    def values(self, given: Mapping[str, float], source: str = "physics") -> dict[str, float]:
        """All parameters: those given, the others at their typical value.

        Raises InputError for names it does not have, and values that are not finite or out of the plausible range.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        for name, value in given.items():
            if name not in known:
                raise InputError(f"{source}.{self.name}: has no {name}; there are {', '.join(known)}")
            parameter = known[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"{source}.{self.name}.{name}: {value!r} is no finite number")
            if not parameter.low <= value <= parameter.high:
                raise InputError(
                    f"{source}.{self.name}.{name}: {value:g} {parameter.unit} is out of the plausible range, "
                    f"{parameter.low:g} to {parameter.high:g}"
                )
        return {name: float(given.get(name, parameter.typical)) for name, parameter in known.items()}


@cache
def names() -> tuple[str, ...]:
    """Every effect of the library, sorted: the files of `effects`."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "__init__"))


def require(name: str, source: str) -> None:
    """Raise InputError, naming `source`, if the library has no effect of this name."""
    if name not in names():
        raise InputError(f"{source}: there is no effect '{name}'; {meant(name, names())}")


def load(name: str, source: str = "physics") -> Effect:
    """The effect of this name. Raises InputError, naming `source`, if there is none."""
    require(name, source)
    return importlib.import_module(f".effects.{name}", __package__).EFFECT


def acts_on_images(name: str) -> bool:
    """Whether an effect acts after the reconstruction, not on projections."""
    return load(name).stage == "image"


def image_effects() -> tuple[str, ...]:
    """Effects of the library that act on reconstructed images, in the order in which they act."""
    effects = [load(name) for name in names() if acts_on_images(name)]
    return tuple(effect.name for effect in sorted(effects, key=lambda effect: (effect.rank, effect.name)))


def check_readings(physics: Mapping[str, Mapping[str, float]], air: float, source: str, scan: str) -> None:
    """Raise InputError, naming `source` and the `scan`, for readings that are implausible beside that in air."""
    for name, values in physics.items():
        for one in load(name).parameters:
            if one.reach is not None and one.reach.of == OF_AIR:
                share = values[one.name] / air
                if not one.reach.low <= share <= one.reach.high:
                    raise InputError(
                        f"{source}.{name}.{one.name}: {values[one.name]:g} is {share:.2g} of the {air:g} photons that "
                        f"{scan} has in air; plausible are {one.reach.low:g} to {one.reach.high:g} of them"
                    )


def needs_times(name: str) -> bool:
    """Whether an effect is nothing that a scan without known times could show: a parameter that goes by them cannot be
    left out, or all do."""
    parameters = load(name).parameters
    return any(one.timed and one.neutral is None for one in parameters) or all(one.timed for one in parameters)


def checked(physics: Mapping[str, Mapping[str, float] | None], source: str = "physics") -> dict[str, dict[str, float]]:
    """Complete settings of effects, {effect: {parameter: value}}, from a configuration's section.

    Raises InputError for unknown effects or parameters and values out of range.
    """
    return {name: load(name, source).values(given or {}, source) for name, given in physics.items()}
