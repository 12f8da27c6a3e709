"""Effects: physics that the baseline simulation leaves out, one file each in `effects`."""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from ..base.errors import InputError, meant
from . import effects

# Stages that displace rays, the object, and the source of rays.
GEOMETRY, MOTION, FOCAL_SPOT = MOVING = ("geometry", "motion", "focal_spot")
# In their order along the beam.
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


# Units of Reach, of a parameter within one scan: the time from view to view, the duration of the scan, the detector's
# reading in air, that reading per duration, and 1 over the photons of a pixel in air.
PER_VIEW, PER_SCAN, OF_AIR, OF_AIR_PER_SCAN = "view interval", "scan", "air", "air over the scan"
PER_AIR_PHOTON = "1 over the photons in air"
READOUT_UNITS = "readout units"  # photons in a study and its recordings; the signal in air for line integrals
LOGARITHM = 0  # as a power: fits vary the logarithm
# Owner of a parameter: recordings of a scanner share it, or those of one of its protocols, or none.
OF_SCANNER, OF_PROTOCOL, OF_SCAN = "scanner", "protocol", "scan"

# Needs of effects, and why an effect is not tried without.
DIVERGENT_BEAM, NOMINAL_PHOTONS = "divergent beam", "nominal photons"
SUCCESSIVE_VIEWS, HELIX = "successive views", "helix"
NEEDS = {
    DIVERGENT_BEAM: "goes by the place of a focal spot, and the beam is parallel",
    NOMINAL_PHOTONS: "needs nominal_photons, which it could differ from and which are not stated",
    SUCCESSIVE_VIEWS: "jumps from view to view, and every second view or fewer are fitted (view_step)",
    HELIX: "goes along the axis, where the source does not move",
}
# What a scanner's label, under `nominal` in recording.yaml, may state of a parameter: a prior.
TUBE_VOLTAGE, SENSOR_THICKNESS = "tube voltage", "sensor thickness"
# What dark frames, readings without a beam before and after a scan, show of a parameter: mean, change, and variance.
DARK_LEVEL, DARK_DRIFT, DARK_NOISE = "dark level", "dark drift", "dark noise"


@dataclass(frozen=True)
class Reach:
    """Range of a parameter within one scan, where its unit carries over to other scans.

    A motion in mm/s, for example, is limited by the mm that it amounts to over the scan.

    Attributes
    ----------
    of : str
        Unit: PER_VIEW, PER_SCAN, OF_AIR, OF_AIR_PER_SCAN or PER_AIR_PHOTON.
    low, high, start : float
        A fit's range and start.
    typical : float
        Typical strength.
    """

    of: str
    low: float
    high: float
    start: float
    typical: float


@dataclass(frozen=True)
class Parameter:
    """Parameter of an effect, in a unit that carries over to the scanner's other scans.

    Attributes
    ----------
    name, unit, meaning : str
    low, high : float
        Plausible range, which limits the configuration and fits.
    start : float
        Start of fits.
    typical : float
        Typical strength, for templates and examples.
    neutral : float or None
        Value at which the effect does nothing; None if there is none.
    power : int
        Power with which a small effect grows: 2 for the width of a blur. Fits vary that power, in which data are more
        linear; LOGARITHM for parameters of any order of magnitude.
    reach : Reach or None
        Range, start and typical strength within one scan; None: as above.
    stated : bool
        Design parameter of the scanner: fits take it at its typical value.
    belongs_to : {"scanner", "protocol", "scan"}
        Owner: the recordings that share it.
    kernel : bool
        Width of a kernel or source of assumed form, which may be another in reality.
    kernel_error : float or None
        Share of the kernel that may be half as wide, one standard deviation; None: the effect's model accuracy.
    nominal : str or None
        Quantity on the scanner's label that is a prior of it: TUBE_VOLTAGE or SENSOR_THICKNESS.
    dark : str or None
        What dark frames show of it: DARK_LEVEL, DARK_DRIFT or DARK_NOISE.
    label : str
        Name in messages; empty: `name` without its unit.
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
    kernel_error: float | None = None
    nominal: str | None = None
    dark: str | None = None
    label: str = ""

    def number(self, value: float) -> float:
        """Return the number that fits vary, for a value."""
        return math.log(value) if self.power == LOGARITHM else value**self.power

    @property
    def timed(self) -> bool:
        """Whether only a scan with known times shows it."""
        return self.reach is not None and self.reach.of not in (OF_AIR, PER_AIR_PHOTON)

    def within(self, scan: Mapping[str, float]) -> Parameter:
        """Return the parameter with range, start and typical strength within one scan.

        Parameters
        ----------
        scan : mapping of str to float
            {unit of Reach: amount of the parameter that makes 1 of it}.

        Returns
        -------
        Parameter
        """
        if self.reach is None:
            return self
        unit = scan[self.reach.of]
        low, high = max(self.low, self.reach.low * unit), min(self.high, self.reach.high * unit)
        start, typical = (min(max(value * unit, low), high) for value in (self.reach.start, self.reach.typical))
        return replace(self, low=low, high=high, start=start, typical=typical)


@dataclass(frozen=True)
class Effect:
    """Physics that the baseline simulation leaves out, with all that the diagnosis needs to know of it.

    Attributes
    ----------
    name : str
        Name of its file.
    physics : str
        Description in a sentence.
    equation : str
        As applied.
    source : str
        Reference.
    stage : str
        One of STAGES.
    signature : str
        What distinguishes it from other effects.
    settled_by : str
        Further recording that shows it alone.
    parameters : tuple of Parameter
    apply : callable
        (state, values by name): changes a state.State in place, or at stage "image" an image_state.ImageState.
    pattern : bool
        One unknown per detector pixel is fitted beside the parameters (rings).
    rank : int
        Order of image effects, then by name: 0 for sharpness, 1 for the numbers.
    beside : str or None
        Effect without which this one does nothing, or is indistinguishable from it.
    needs : tuple of str
        Keys of NEEDS: conditions of a scan under which it is tried.
    of_one_scan : bool
        Each scan of a scanner has its own, so that joint diagnoses do not try it.
    removed_by : tuple of str
        Corrections by the scanner's maker (`corrected` in recording.yaml) that remove it: then it is not tried.
    correction : str
        Correction by the scanner's maker that it models: it is tried only where that was made.
    absolute_attenuation : bool
        It gives attenuation absolutely, so that beside it the scale of line integrals is the object's density alone.
    if_absent : str
        Warning where the data reject it although the label states a tube voltage, {tube_kvp} in kV.
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
    needs: tuple[str, ...] = ()
    of_one_scan: bool = False
    removed_by: tuple[str, ...] = ()
    correction: str = ""
    absolute_attenuation: bool = False
    if_absent: str = ""

    @property
    def kinematic(self) -> bool:
        """Whether it only displaces rays or the object: a position involves no model that could be inexact."""
        return self.stage in (GEOMETRY, MOTION) or all(map(self.moves, self.parameters))

    def moves(self, parameter: Parameter) -> bool:
        """Return whether a parameter displaces rays or the object to first order: the width of a blur does not."""
        return self.stage in MOVING and parameter.power == 1 and parameter.unit != "1" and not parameter.kernel

    def values(self, given: Mapping[str, float], source: str = "physics") -> dict[str, float]:
        """Return all parameters: given values, typical values for the others.

        Parameters
        ----------
        given : mapping of str to float
        source : str, optional
            Prefix of messages.

        Returns
        -------
        dict of str to float

        Raises
        ------
        InputError
            For unknown names, and values that are not finite or out of the plausible range.
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
    """Return the names of all effects, sorted: files of `effects` and of folders that were added."""
    return _names(tuple(effects.__path__))


@cache
def _names(folders: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted(one.name for one in pkgutil.iter_modules(folders)))


def add_folder(folder: str | Path) -> tuple[str, ...]:
    """Add the effects of a folder to the library until Python exits.

    Parameters
    ----------
    folder : str or Path
        Every Python file in it is an effect like those in `effects`, and may import from `..effect` and `..state`.

    Returns
    -------
    tuple of str
        Their names.

    Raises
    ------
    InputError
        If the folder is missing or holds no Python file, or a file has the name of an existing effect.
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
    """Check that there is an effect of this name.

    Raises
    ------
    InputError
        If there is none; the message begins with `source`.
    """
    if name not in names():
        raise InputError(f"{source}: there is no effect '{name}'; {meant(name, names())}")


def load(name: str, source: str = "physics") -> Effect:
    """Return the effect of a name.

    Returns
    -------
    Effect

    Raises
    ------
    InputError
        If there is none; the message begins with `source`.
    """
    require(name, source)
    return importlib.import_module(f".effects.{name}", __package__).EFFECT


def offered(candidates: Iterable[str], there: Collection[str]) -> list[str]:
    """Return the candidates that can act beside the effects that are there."""
    return [name for name in candidates if (needed := load(name).beside) is None or needed in there]


def acts_on_images(name: str) -> bool:
    """Return whether an effect acts on reconstructed images, not on projections."""
    return load(name).stage == "image"


def image_effects() -> tuple[str, ...]:
    """Return the effects on reconstructed images, in the order in which they act."""
    effects = [load(name) for name in names() if acts_on_images(name)]
    return tuple(effect.name for effect in sorted(effects, key=lambda effect: (effect.rank, effect.name)))


def check_readings(physics: Mapping[str, Mapping[str, float]], air: float, source: str, scan: str) -> None:
    """Check parameters that are readings of the detector against its reading in air.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float
        {effect: {parameter: value}}.
    air : float
        Reading in air, photons.
    source, scan : str
        Prefix of messages, and name of the scan in them.

    Raises
    ------
    InputError
        For an implausible reading.
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


def absolute_attenuation(effects: Iterable[str]) -> bool:
    """Return whether one of these effects gives attenuation absolutely."""
    return any(load(name).absolute_attenuation for name in effects)


def needing(need: str) -> list[str]:
    """Return the effects that declare a need."""
    return [name for name in names() if need in load(name).needs]


def scan_effects() -> list[str]:
    """Return the effects that each scan of a scanner has of its own."""
    return [name for name in names() if load(name).of_one_scan]


def of_one_scan(name: str) -> dict[str, float | None]:
    """Return the parameters of an effect that belong to one scan, with their neutral values."""
    return {one.name: one.neutral for one in load(name).parameters if one.belongs_to == OF_SCAN}


def needs_times(name: str) -> bool:
    """Return whether an effect cannot be detected without the scan's times."""
    parameters = load(name).parameters
    return any(one.timed and one.neutral is None for one in parameters) or all(one.timed for one in parameters)


def checked(physics: Mapping[str, Mapping[str, float] | None], source: str = "physics") -> dict[str, dict[str, float]]:
    """Return complete settings of effects from a section of the configuration.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float, or None
        {effect: {parameter: value}}; missing parameters are typical.
    source : str, optional
        Prefix of messages.

    Returns
    -------
    dict of str to dict of str to float

    Raises
    ------
    InputError
        For unknown effects or parameters, and values out of range.
    """
    for name, given in physics.items():
        if given is not None and not isinstance(given, Mapping):
            raise InputError(
                f"{source}.{name} is {given!r}; give a mapping of its parameters, or null for typical ones"
            )
    return {name: load(name, source).values(given or {}, source) for name, given in physics.items()}
