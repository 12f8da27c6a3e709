"""Effects: physics that the baseline lacks, one file each in `effects`."""

from __future__ import annotations

import importlib
import math
import pkgutil
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from ..base.errors import InputError, did_you_mean
from ..base.names import label
from . import effects

# Stages that displace the rays, the object and the source.
GEOMETRY, MOTION, FOCAL_SPOT = MOVING = ("geometry", "motion", "focal_spot")
# Stages in the order in which they act.
STAGES = (GEOMETRY, MOTION, "spectrum", "fluence", FOCAL_SPOT, "scatter", "crosstalk", "noise", "readout", "image")
# Units of a parameter relative to one scan are the view interval, the scan time and its square. Others are the reading
# in air, the same per scan time, 1 / photons per pixel in air, and the larger pitch of the pixels.
PER_VIEW, PER_SCAN, OF_AIR, OF_AIR_PER_SCAN = "view interval", "scan", "air", "air over the scan"
PER_SCAN_SQUARED, PER_AIR_PHOTON, PER_PIXEL = "scan squared", "1 over the photons in air", "pixel"
TIMED = (PER_VIEW, PER_SCAN, PER_SCAN_SQUARED, OF_AIR_PER_SCAN)
READOUT_UNITS = "readout units"  # photons in a study and its recordings; the signal in air for line integrals alone
# Units that end the name of a parameter, such as width_mm and rows_mm_per_s.
UNIT_AT_END = re.compile(r"(_(mm|um|deg|px|hu|ms|units))?(_per_(s2?|mm2?|photon))?$")
LENGTH = re.compile(r"\b[mu]m")  # in a unit
LOGARITHM = 0  # value of Parameter.power: fits use the logarithm
# Scope of a parameter: shared by all recordings of a scanner, by those of one protocol, or by none.
OF_SCANNER, OF_PROTOCOL, OF_SCAN = "scanner", "protocol", "scan"
# Conditions of a scan that effects need (Effect.needs), and why an effect is not tried without them.
DIVERGENT_BEAM, NOMINAL_PHOTONS = "divergent beam", "nominal photons"
SUCCESSIVE_VIEWS, HELIX, CLOSE_VIEWS = "successive views", "helix", "close views"
DIFFERENT_SLICES, NOISE_LEVEL = "different slices", "noise level"
NEEDS = {
    DIVERGENT_BEAM: "needs a focal spot, but the beam is parallel",
    NOMINAL_PHOTONS: "is relative to nominal_photons, which are not stated",
    SUCCESSIVE_VIEWS: "changes from view to view, but at most every second view is fitted (view_step)",
    HELIX: "changes along the axis, but the source does not move along it",
    CLOSE_VIEWS: "needs rays between views, and the views of the simulation are too far apart to interpolate",
    DIFFERENT_SLICES: "acts between slices, and slices of an object are repeats of one slice",
    NOISE_LEVEL: "acts on noise alone, which images of an object take from the recording",
}
# Quantities on the scanner's label that are priors of parameters (Parameter.nominal).
TUBE_VOLTAGE, SENSOR_THICKNESS = "tube voltage", "sensor thickness"
# Mean, change and variance of dark frames, which measure parameters (Parameter.dark).
DARK_LEVEL, DARK_DRIFT, DARK_NOISE = "dark level", "dark drift", "dark noise"


@dataclass(frozen=True)
class Reach:
    """Range of a parameter in a unit that depends on the scan.

    For example, the plausible velocities in mm/s follow from a plausible displacement in mm over the scan.

    Attributes
    ----------
    of : str
        Unit of the range: PER_VIEW, PER_SCAN, PER_SCAN_SQUARED, OF_AIR, OF_AIR_PER_SCAN, PER_AIR_PHOTON or PER_PIXEL.
    low, high : float
        Range of a fit.
    start, typical : float or None
        Start of a fit, and typical strength; None: those of the parameter.
    """

    of: str
    low: float
    high: float
    start: float | None = None
    typical: float | None = None


@dataclass(frozen=True)
class Parameter:
    """Parameter of an effect, in a unit that is valid for all scans of the scanner.

    Attributes
    ----------
    low, high : float
        Plausible range of configurations and fits.
    start : float
        Start of a fit.
    typical : float
        Strength typical of scanners, for templates and examples.
    neutral : float or None
        Value at which the effect does nothing; None if there is none.
    power : int
        Power of the parameter in which a small effect is linear: 2 for the width of a blur. Fits use this power, or
        the logarithm (LOGARITHM) if the magnitude is unknown.
    reach : Reach or None
        Range relative to one scan; None: low, high, start and typical.
    stated : bool
        Whether the parameter is part of the scanner design; fits keep its typical value.
    belongs_to : {"scanner", "protocol", "scan"}
        Recordings that share its value.
    kernel : bool
        Whether the parameter is the width of a kernel or source whose shape is an assumption.
    kernel_error : float or None
        Standard deviation of the error of the kernel's shape: amplitude of a kernel of half the width, relative to the
        kernel; None: the relative error of the effect's model.
    nominal : str or None
        Quantity on the scanner's label that is its prior: TUBE_VOLTAGE or SENSOR_THICKNESS.
    dark : str or None
        Property of dark frames that measures the parameter: DARK_LEVEL, DARK_DRIFT or DARK_NOISE.
    periodic : bool
        Whether images change periodically with the inverse of a length, so that fits need many starts.
    field_of_view : bool
        Whether the parameter is the radius of the field of view, so that fits also start at the edge of the voxels.
    fraction : bool
        Whether 0 and 1 are limits of physics rather than of plausibility, so that a fit may end there.
    unstated : float or None
        Exact value where a declaration of the effect does not mention the parameter; None: it must.
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
    kernel_error: float | None = None
    nominal: str | None = None
    dark: str | None = None
    periodic: bool = False
    field_of_view: bool = False
    fraction: bool = False
    unstated: float | None = None
    title: str = ""

    @property
    def display_name(self) -> str:
        """Name in texts, without the unit."""
        name = self.title or label(UNIT_AT_END.sub("", self.name))
        return f"kernel {name}" if self.kernel and not self.title else name

    def to_variable(self, value: float) -> float:
        """Return the variable that fits use in place of a value: its power or its logarithm."""
        return math.log(value) if self.power == LOGARITHM else value**self.power

    @property
    def timed(self) -> bool:
        """Whether the parameter can be determined only from scans with known times."""
        return self.reach is not None and self.reach.of in TIMED

    def within(self, scan: Mapping[str, float]) -> Parameter:
        """Return the parameter with the range, start and typical strength of one scan.

        Parameters
        ----------
        scan : mapping of str to float
            {unit of Reach: its size in the unit of the parameter}.
        """
        if self.reach is None:
            return self
        one = scan[self.reach.of]
        low, high = max(self.low, self.reach.low * one), min(self.high, self.reach.high * one)
        values = (self.reach.start, self.start), (self.reach.typical, self.typical)
        start, typical = (min(max(own if value is None else value * one, low), high) for value, own in values)
        return replace(self, low=low, high=high, start=start, typical=typical)


@dataclass(frozen=True)
class Effect:
    """Physics that the baseline lacks.

    Attributes
    ----------
    name : str
        Name of its file.
    physics : str
        Physical description for catalogue and reports.
    equation : str
        Equation as applied.
    source : str
        References.
    stage : str
        One of STAGES.
    signature : str
        Features of the data that distinguish it from other effects.
    settled_by : str
        Recording that would confirm it, as an instruction.
    apply : callable
        (state, values by name): changes a state.State in place, or an image_state.ImageState at stage "image".
    mtf : callable or None
        (frequencies per mm, values by name): factor of the MTF, if the effect is a filter of the reconstruction.
        Filtered back-projection applies it to projections, because images contain aliased frequencies.
    pattern : bool
        Whether one unknown per detector pixel is fitted in place of the parameters (rings).
    uneven : bool
        Whether the dark signal of this effect differs between pixels, so that one relative deviation per pixel is
        fitted in addition to the parameters.
    beside : str or None
        Effect that must be present: without it, this effect does nothing or cannot be distinguished from it.
    rank : int
        Order of image effects: -1 for artifacts of projections, 0 for sharpness, 1 for HU values. Effects of the same
        rank are sorted by name.
    needs : tuple of str
        Conditions that a scan must fulfill for the effect to be fitted: keys of NEEDS.
    of_one_scan : bool
        Whether the effect differs between the scans of a scanner; joint diagnoses do not fit it.
    removed_by : tuple of str
        Corrections by the scanner's maker (`corrected` in recording.yaml) that remove the effect, so it is not fitted.
    correction : str
        Correction by the scanner's maker that the effect models; it is fitted only to scans with this correction.
    absolute_attenuation : bool
        Whether the effect determines attenuation absolutely. If it is fitted, the scale of line integrals is the
        density of the object.
    if_absent : str
        Warning if the data reject the effect although the label states a tube voltage, {tube_kvp} in kV.
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
    mtf: Callable | None = None
    pattern: bool = False
    uneven: bool = False
    rank: int = 0
    beside: str | None = None
    needs: tuple[str, ...] = ()
    of_one_scan: bool = False
    removed_by: tuple[str, ...] = ()
    correction: str = ""
    absolute_attenuation: bool = False
    if_absent: str = ""
    title: str = ""

    @property
    def display_name(self) -> str:
        """Name in texts."""
        return self.title or label(self.name)

    @property
    def kinematic(self) -> bool:
        """Whether the effect only moves rays or the object. Such effects have no model error."""
        return self.stage in (GEOMETRY, MOTION) or all(map(self.moves, self.parameters))

    @property
    def shades(self) -> bool:
        """Whether the effect changes uniform areas of images, which no filter of the reconstruction does."""
        return self.stage == "image" and self.rank != 0 and not self.pattern

    def moves(self, parameter: Parameter) -> bool:
        """Whether a parameter displaces rays or the object to first order; the width of a blur does not."""
        return self.stage in MOVING and parameter.power == 1 and parameter.unit != "1" and not parameter.kernel

    def values(self, given: Mapping[str, float], source: str = "physics") -> dict[str, float]:
        """Return all parameters: those given, the others at their typical value.

        Parameters
        ----------
        source : str, optional
            Start of error messages.

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
                unit = "" if parameter.unit == "1" else f" {parameter.unit}"
                raise InputError(
                    f"{source}.{self.name}.{name}: {value:g}{unit} is out of the plausible range, "
                    f"{parameter.low:g} to {parameter.high:g}"
                )
        return {name: float(given.get(name, parameter.typical)) for name, parameter in known.items()}


def names() -> tuple[str, ...]:
    """Return the names of all effects, sorted: the files in `effects` and in added folders."""
    return _names(tuple(effects.__path__))


@cache
def _names(folders: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted(one.name for one in pkgutil.iter_modules(folders)))


def add_folder(folder: str | Path) -> tuple[str, ...]:
    """Register the effects of a folder for the running Python process.

    Parameters
    ----------
    folder : str or Path
        Each Python file in it is an effect, like those in `effects`, and may import from `..effect` and `..state`.

    Returns
    -------
    tuple of str
        Names of its effects.

    Raises
    ------
    InputError
        If the folder does not exist, has no Python file, or a name is already used.
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
    """Check that an effect of this name exists.

    Raises
    ------
    InputError
        Naming `source`, if it does not.
    """
    if name not in names():
        raise InputError(f"{source}: there is no effect '{name}'; {did_you_mean(name, names())}")


def load(name: str, source: str = "physics") -> Effect:
    """Return the effect of this name.

    Raises
    ------
    InputError
        Naming `source`, if there is none.
    """
    require(name, source)
    return importlib.import_module(f".effects.{name}", __package__).EFFECT


def applicable_effects(candidates: Iterable[str], there: Collection[str]) -> list[str]:
    """Return the candidates whose required effect (Effect.beside), if they have one, is present."""
    return [name for name in candidates if (needed := load(name).beside) is None or needed in there]


def acts_on_images(name: str) -> bool:
    """Whether an effect acts after the reconstruction, not on projections."""
    return load(name).stage == "image"


def image_effects() -> tuple[str, ...]:
    """Return the names of effects on reconstructed images, in order of application."""
    return _image_effects(names())


@cache
def _image_effects(known: tuple[str, ...]) -> tuple[str, ...]:
    found = [load(name) for name in known if acts_on_images(name)]
    return tuple(effect.name for effect in sorted(found, key=lambda effect: (effect.rank, effect.name)))


@dataclass(frozen=True)
class FilterFactor:
    """Factor of the MTF by an effect at given values."""

    effect: str
    values: tuple[tuple[str, float], ...]

    def __call__(self, cycles_per_mm: np.ndarray) -> np.ndarray:
        """Return the factor at frequencies in cycles per mm."""
        return load(self.effect).mtf(cycles_per_mm, dict(self.values))


def filter_factor(physics: Mapping[str, Mapping[str, float]]) -> FilterFactor | None:
    """Return the factor of the MTF by the filter among these effects (Effect.mtf); None without one, or at 1."""
    for name, values in physics.items():
        one = load(name)
        if one.mtf and any(number.neutral not in (None, values[number.name]) for number in one.parameters):
            return FilterFactor(name, tuple(values.items()))
    return None


def check_readings(physics: Mapping[str, Mapping[str, float]], air: float, source: str, scan: str) -> None:
    """Reject parameters that are implausible relative to the reading in air.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float
        {effect: {parameter: value}}.
    air : float
        Reading in air, photons.
    source, scan : str
        Start of error messages, and name of the scan in them.

    Raises
    ------
    InputError
        For an implausible value.
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
    """Return whether one of these effects determines attenuation absolutely."""
    return any(load(name).absolute_attenuation for name in effects)


def effects_needing(need: str) -> list[str]:
    """Return the effects that need a condition."""
    return [name for name in names() if need in load(name).needs]


def scan_effects() -> list[str]:
    """Return the effects that differ between the scans of a scanner."""
    return [name for name in names() if load(name).of_one_scan]


def scan_parameters(name: str) -> dict[str, float | None]:
    """Return {parameter: neutral value} of the parameters of an effect that belong to a single scan."""
    return {one.name: one.neutral for one in load(name).parameters if one.belongs_to == OF_SCAN}


def needs_times(name: str) -> bool:
    """Whether an effect is detectable only in scans with known times.

    This is the case if all parameters depend on time, or if one time-dependent parameter has no neutral value.
    """
    parameters = load(name).parameters
    return any(one.timed and one.neutral is None for one in parameters) or all(one.timed for one in parameters)


def needs_lengths(name: str) -> bool:
    """Whether an effect has a parameter with a length in its unit, so that a scan without a scale cannot show it."""
    return any(LENGTH.search(one.unit) for one in load(name).parameters)


def checked(physics: Mapping[str, Mapping[str, float] | None], source: str = "physics") -> dict[str, dict[str, float]]:
    """Check and complete the settings of effects in a configuration.

    Parameters
    ----------
    physics : mapping of str to mapping of str to float, or None
        {effect: {parameter: value}}; missing parameters take their typical value.
    source : str, optional
        Start of error messages.

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
