"""What speaks against taking the named effects at their word: bounds that were reached, and noise that does not fit."""

from __future__ import annotations

from collections.abc import Mapping

from ...base.words import enumerated, label
from ...physics.beam.sensors import STATED_SD
from ...physics.effect import Parameter
from ..fitting.fit import Fit
from ..fitting.model import TUBE_KVP_SD, Model
from ..fitting.nuisance import SURE, Nuisance
from ..fitting.unknown import Unknown
from ..selection.forward_selection import Choice

# Share of a range, or of what the alignment may be off by, within which a number counts as at its bound: steps of fits
# end on the bound itself.
AT_BOUND = 1e-6
# Standard errors that must go into a range for its end to say anything: else the 95 % interval fills it.
WELL_KNOWN = 4.0
# Chi-square per datum of the mean from which the model is no fit: a difference of half the noise's SD in every datum.
MOST_CHI_SQUARE = 1.25

NAMED = {"sensor_mm": "sensor thickness"}  # of parameters whose name is not read as what they are
ADVISED = ("scale", "offset", "x_mm", "y_mm", "z_mm", "turn_deg", "size")  # keys of the configuration's alignment


def doubts(choice: Choice, model: Model, held_out: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Phrases for the verdict; none if all is well.

    Parameters
    ----------
    held_out : mapping
        Numbers before and after, from verdict.metrics_of.
    """
    fit = choice.chosen.fit
    found = []
    plausible = {(name, one.name): one for name in fit.effects for one in model.parameters(name)}
    for one in model.unknowns(fit.effects):
        value, error = fit.physics[one.effect][one.name], fit.errors[one.effect].get(one.name, 0.0)
        low, high = one.value(one.low), one.value(one.high)
        if WELL_KNOWN * error > high - low:  # the data do not tell it: any place of the range would do
            continue
        # The lower end of what begins at 0 is its absence.
        ends = {"upper": high} | ({"lower": low} if low not in (0, one.neutral) else {})
        for end, bound in ends.items():
            if abs(value - bound) <= AT_BOUND * (high - low):
                named, amount = _quantity(plausible[one.effect, one.name], value)
                known = _stated(one, model) or f"not stated, the {end} end of its range"
                found.append(f"{named} of {label(one.effect)} is {amount} ({known})")
    if pulled := _pulled(fit, model):
        names = enumerated([label(one.name) for one in pulled])
        moved = "; ".join(
            f"to {fit.nuisance[one.name]:.3g}, known: {one.expected:.3g} ± {one.sd:.3g}" for one in pulled
        )
        found.append(
            f"{names} of the alignment had to be pulled as far as a fit may ({SURE:g} standard deviations: {moved})"
        )
    left = held_out.get("chi_square_mean", {}).get("after", 1.0)
    if left > MOST_CHI_SQUARE:
        found.append(f"chi-square per datum is {left:.2f} where noise alone gives 1.00")
    return found


def advice(fit: Fit, model: Model) -> list[str]:
    """Sentences on what to state where the alignment had to be pulled as far as a fit may.

    Returns
    -------
    list of str
        One for each number that the configuration may give: not for photons and numerical errors.
    """
    found = []
    for one in _pulled(fit, model):
        if one.name not in ADVISED:
            continue
        why = "it is the density of the object, which is often known to some per cent" * (one.name == "scale")
        found.append(
            f"{label(one.name).capitalize()} of the alignment is taken to be known to {one.sd:.3g}"
            f"{': ' + why if why else ''}. If it may be farther off, give its standard deviation: "
            f"alignment: {{{one.name}: ...}} under diagnosis.recordings (docs/how-to/diagnosis.md)."
        )
    return found


def _pulled(fit: Fit, model: Model) -> list[Nuisance]:
    """The numbers of the alignment that lie at the most that the fit let them be off by."""
    most = SURE * (1 - AT_BOUND)
    return [one for one in model.alignment(fit.effects) if abs(fit.pulled.get(one.name, 0.0)) > most]


def _quantity(parameter: Parameter, value: float) -> tuple[str, str]:
    """A parameter's name without its unit, and its value with it."""
    begin, _, end = parameter.name.rpartition("_")
    name = begin if begin and parameter.unit.startswith(end) else parameter.name
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return NAMED.get(parameter.name, label(name)), f"{value:.3g}{unit}"


def _stated(one: Unknown, model: Model) -> str | None:
    """What is stated of a parameter and how well it is known, in words; None: nothing is."""
    said = model.declared.get(one.effect, {}).get(one.name)
    if said is not None:
        return f"stated: {said.value:g}, known within {said.sd:g}"
    if (one.effect, one.name) == ("spectrum", "kvp") and model.tube_kvp is not None:
        return f"stated: {model.tube_kvp:g}, known within {TUBE_KVP_SD:g}"
    sensor = model.chain.sensor
    if (one.effect, one.name) == ("spectrum", "sensor_mm") and sensor.thickness_sd <= STATED_SD:
        return f"stated: {sensor.thickness_mm:g}, known within {100 * sensor.thickness_sd:g} %"
    return None
