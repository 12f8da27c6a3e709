"""What an effect is: a piece of physics that the baseline leaves out, one file each in `effects`."""

from __future__ import annotations

import importlib
import math
import pkgutil
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from ..base.errors import InputError, meant
from ..base.words import label
from . import effects

# Stages of what moves rays, the object, and where rays begin.
GEOMETRY, MOTION, FOCAL_SPOT = MOVING = ("geometry", "motion", "focal_spot")
# In the order in which they act.
STAGES = (
    GEOMETRY,
    MOTION,
    "spectrum",
    "fluence",
    FOCAL_SPOT,
    "scatter",
    "crosstalk",
    "noise",
    "readout",
    "image",
)


# What a parameter is counted in where one scan is asked about: the time from view to view, that of the whole scan, what
# the detector reads in air, that over the scan's time, and 1 over the photons of a pixel in air.
PER_VIEW, PER_SCAN, OF_AIR, OF_AIR_PER_SCAN = "view interval", "scan", "air", "air over the scan"
PER_AIR_PHOTON = "1 over the photons in air"
READOUT_UNITS = (
    "readout units"  # in a study and of its own recordings photons, of line integrals alone the signal in air
)
# Effects that go by the place or size of the focal spot, or by angles and distances from it: parallel rays know none.
OF_A_SPOT = (
    "anti_scatter_grid",
    "bowtie",
    "focal_spot",
    "focal_spot_wobble",
    "heel",
    "off_focal_radiation",
    "source_distance",
    "source_drift",
)
# Units that end the name of a parameter, such as width_mm and rows_mm_per_s.
UNIT_AT_END = re.compile(r"(_(mm|um|deg|px|hu|ms|units))?(_per_(s|mm2?|photon))?$")
LOGARITHM = 0  # as a power: fits vary the logarithm
# Whose a parameter is: all recordings of a scanner have it in common, those of one of its protocols, or none.
OF_SCANNER, OF_PROTOCOL, OF_SCAN = "scanner", "protocol", "scan"


@dataclass(frozen=True)
class Reach:
    """What one scan shows of a parameter whose unit carries over to others.

    A motion in mm/s, say, is told by the mm that it amounts to over the scan.

    Attributes
    ----------
    of : str
        What it is counted in: PER_VIEW, PER_SCAN, OF_AIR, OF_AIR_PER_SCAN or PER_AIR_PHOTON.
    low, high, start : float
        A fit's range and start.
    typical : float
        A typical strength.
    """

    of: str
    low: float
    high: float
    start: float
    typical: float


@dataclass(frozen=True)
class Parameter:
    """A number that an effect has, in a unit that carries over to the scanner's other scans.

    Attributes
    ----------
    low, high : float
        Plausible range, which the configuration and the fit keep to.
    start : float
        Where a fit begins.
    typical : float
        A strength that scanners show, for templates and examples.
    neutral : float or None
        At this value the effect does nothing; None if there is none.
    power : int
        With which power of it a small effect grows: 2 for the width of a blur. Fits vary that power, in which data are
        straighter; LOGARITHM of what may be of any size.
    reach : Reach or None
        What of it one scan shows; None: as the range, start and typical strength say.
    stated : bool
        Of the scanner's design: a fit takes it at its typical value.
    belongs_to : {"scanner", "protocol", "scan"}
        Which recordings have it in common.
    kernel : bool
        The width of a kernel or source whose form is assumed: that of a real one may be another.
    title : str
        Name in texts; empty: `name` without its unit.
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
    stated: bool = False
    belongs_to: str = OF_SCANNER
    kernel: bool = False
    title: str = ""

    @property
    def display_name(self) -> str:
        """Name in texts, without the unit."""
        name = self.title or label(UNIT_AT_END.sub("", self.name))
        return f"kernel {name}" if self.kernel and not self.title else name

    def number(self, value: float) -> float:
        """What fits vary, of a value."""
        return math.log(value) if self.power == LOGARITHM else value**self.power

    @property
    def timed(self) -> bool:
        """Whether it can be told only of a scan whose times are known."""
        return self.reach is not None and self.reach.of not in (OF_AIR, PER_AIR_PHOTON)

    def within(self, scan: Mapping[str, float]) -> Parameter:
        """Itself with range, start and typical strength as one scan shows them.

        Parameters
        ----------
        scan : mapping of str to float
            {unit of Reach: how much of the parameter is 1 of it}.
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

    Attributes
    ----------
    name : str
        Of its file.
    physics : str
        What happens, in a sentence.
    equation : str
        As applied.
    source : str
        Where it is described.
    stage : str
        One of STAGES.
    signature : str
        What tells it apart from others.
    settled_by : str
        The further recording that shows it alone.
    apply : callable
        (state, values by name): changes in place a state.State, or at stage "image" an image_state.ImageState.
    pattern : bool
        True if one unknown per detector pixel is fitted beside the parameters (rings).
    beside : str or None
        The effect without which this one does nothing, or is no other than that one.
    rank : int
        Of image effects, which act in the order of their ranks, and of their names where these are equal: 0 for
        sharpness, 1 for the numbers.
    title : str
        Name in texts; empty: `name` with spaces.
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
    beside: str | None = None
    title: str = ""

    @property
    def display_name(self) -> str:
        """Name in texts."""
        return self.title or label(self.name)

    @property
    def kinematic(self) -> bool:
        """Whether it only moves rays or the object: where these are is no model that could be inexact."""
        return self.stage in (GEOMETRY, MOTION) or all(map(self.moves, self.parameters))

    def moves(self, parameter: Parameter) -> bool:
        """Whether a parameter displaces rays or the object, to first order: the width of a blur does not."""
        return self.stage in MOVING and parameter.power == 1 and parameter.unit != "1" and not parameter.kernel

    def values(self, given: Mapping[str, float], source: str = "physics") -> dict[str, float]:
        """All parameters: those given, the others at their typical value.

        Parameters
        ----------
        source : str, optional
            What the message begins with.

        Raises
        ------
        InputError
            For names it does not have, and values that are not finite or out of the plausible range.
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


def names() -> tuple[str, ...]:
    """Every effect that there is, sorted: the files of `effects`, and of folders that were added."""
    return _names(tuple(effects.__path__))


@cache
def _names(folders: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted(one.name for one in pkgutil.iter_modules(folders)))


def add_folder(folder: str | Path) -> tuple[str, ...]:
    """Let the library know the effects of a folder of one's own, for as long as Python runs.

    Parameters
    ----------
    folder : str or Path
        Every Python file in it is an effect, as those in `effects` are, and may import from `..effect` and `..state`.

    Returns
    -------
    tuple of str
        Their names.

    Raises
    ------
    InputError
        If there is no such folder, it holds no Python file, or one has the name of an effect that there is.
    """
    folder = Path(folder).resolve()
    found = _names((str(folder),))
    if not found:
        raise InputError(f"{folder}: holds no effects; name a folder of Python files, one for each")
    for name in found:
        if name in names():
            raise InputError(f"{folder / name}.py: there is an effect '{name}' already; give it another name")
    effects.__path__.append(str(folder))
    return found


def require(name: str, source: str) -> None:
    """Check that the library has an effect of this name.

    Raises
    ------
    InputError
        Naming `source`, if it has not.
    """
    if name not in names():
        raise InputError(f"{source}: there is no effect '{name}'; {meant(name, names())}")


def load(name: str, source: str = "physics") -> Effect:
    """The effect of this name.

    Raises
    ------
    InputError
        Naming `source`, if there is none.
    """
    require(name, source)
    return importlib.import_module(f".effects.{name}", __package__).EFFECT


def offered(candidates: Iterable[str], there: Collection[str]) -> list[str]:
    """The candidates that can do something beside the effects that are there."""
    return [name for name in candidates if (needed := load(name).beside) is None or needed in there]


def acts_on_images(name: str) -> bool:
    """Whether an effect acts after the reconstruction, not on projections."""
    return load(name).stage == "image"


def image_effects() -> tuple[str, ...]:
    """Effects of the library that act on reconstructed images, in the order in which they act."""
    effects = [load(name) for name in names() if acts_on_images(name)]
    return tuple(effect.name for effect in sorted(effects, key=lambda effect: (effect.rank, effect.name)))


def check_readings(physics: Mapping[str, Mapping[str, float]], air: float, source: str, scan: str) -> None:
    """Refuse readings that are implausible beside that in air.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float
        {effect: {parameter: value}}.
    air : float
        Reading in air, photons.
    source, scan : str
        What the message begins with, and what the scan is called in it.

    Raises
    ------
    InputError
        For such a reading.
    """
    for name, values in physics.items():
        for one in load(name).parameters:
            if one.reach is not None and one.reach.of == OF_AIR:
                share = values[one.name] / air
                if not one.reach.low <= share <= one.reach.high:
                    raise InputError(
                        f"{source}.{name}.{one.name}: {values[one.name]:g} is {share:.2g} of the {air:g} photons that "
                        f"{scan} has in air; plausible are {one.reach.low:g} to {one.reach.high:g} of them"
                    )
            if one.reach is not None and one.reach.of == PER_AIR_PHOTON:
                times = values[one.name] * air
                if not one.reach.low <= times <= one.reach.high:
                    raise InputError(
                        f"{source}.{name}.{one.name}: {values[one.name]:g} times the {air:g} photons that {scan} has "
                        f"in air is {times:.2g}; plausible are {one.reach.low:g} to {one.reach.high:g}"
                    )


def of_one_scan(name: str) -> dict[str, float | None]:
    """Parameters of an effect that other scans of the scanner have of their own, with their neutral values."""
    return {one.name: one.neutral for one in load(name).parameters if one.belongs_to == OF_SCAN}


def needs_times(name: str) -> bool:
    """Whether an effect is nothing that a scan without known times could show.

    That is so if a parameter that goes by them cannot be left out, or all do.
    """
    parameters = load(name).parameters
    return any(one.timed and one.neutral is None for one in parameters) or all(one.timed for one in parameters)


def checked(physics: Mapping[str, Mapping[str, float] | None], source: str = "physics") -> dict[str, dict[str, float]]:
    """Complete settings of effects from a configuration's section.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float, or None
        {effect: {parameter: value}}; parameters that are not given are typical.
    source : str, optional
        What the message begins with.

    Raises
    ------
    InputError
        For unknown effects or parameters and values out of range.
    """
    for name, given in physics.items():
        if given is not None and not isinstance(given, Mapping):
            raise InputError(
                f"{source}.{name} is {given!r}; give a mapping of its parameters, or null for typical ones"
            )
    return {name: load(name, source).values(given or {}, source) for name, given in physics.items()}
