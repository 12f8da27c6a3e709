"""Physics that was found on one recording, held against another.

Only the alignment is fitted there, and parameters that every scan has of its own.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...base.errors import InputError, refusing
from ...io.documents import DIAGNOSIS, read_document
from ...io.schema import defaults_of
from ...physics.effect import READOUT_UNITS, checked, load, of_one_scan
from ..fitting.fit import Fitter
from ..fitting.joint_fit import NOT_OF_SCAN, those
from ..fitting.steps import NORMAL_95
from ..fitting.trial import Trial, trial
from ..uncertainty.model_error import Errors
from ..wording import sentence
from .forward_selection import Choice


@dataclass(frozen=True)
class Physics:
    """What a diagnosis found.

    Attributes
    ----------
    recording : str
        Where.
    effects, errors : dict of str to dict of str to float
        {effect: {parameter: value}}, and their standard errors, inexact models counted.
    units : dict of str to dict of str to str
        {effect: {parameter: unit}}.
    scale : tuple of 2 float, or None
        Value and standard error of all line integrals, where a spectrum makes it the material's density.
    not_taken : tuple of str
        Effects that belong to one scan: patterns of its pixels, which diagnosis.json does not hold.
    noise : dict of str to dict of str to float
        As `errors`, for noise alone; of a parameter that is not there, these.
    """

    recording: str
    effects: dict[str, dict[str, float]]
    errors: dict[str, dict[str, float]]
    units: dict[str, dict[str, str]]
    scale: tuple[float, float] | None
    not_taken: tuple[str, ...]
    noise: dict[str, dict[str, float]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: str | Path, needed: bool = True) -> Physics:
        """From a diagnosis.json.

        Raises
        ------
        InputError
            If it is missing or broken, or, if `needed`, found no physics to take.
        """
        kinds = (OSError, ValueError, KeyError, TypeError)
        with refusing(f"{path}: is no diagnosis", *kinds, advice="make it again"):
            content = read_document(path, DIAGNOSIS)
            if "alignment" not in content:  # nothing was fitted
                raise InputError(f"{path}: {content['sentence']} Physics cannot be taken from it; mend that first")
            found = {one["name"]: one["parameters"] for one in content["effects"]}
            recording, scale = content["recording"], content["alignment"]["scale"]
            taken = {name: values for name, values in found.items() if not load(name).pattern}
            effects = checked({n: {k: v["value"] for k, v in values.items()} for n, values in taken.items()}, str(path))
            errors = {n: {k: _error(v) for k, v in values.items()} for n, values in taken.items()}
            noise = {n: {k: _error(v, "ci95_noise") for k, v in values.items()} for n, values in taken.items()}
            units = {n: {k: v["unit"] for k, v in values.items()} for n, values in taken.items()}
            density = (scale["value"], _error(scale)) if "spectrum" in effects else None
        if needed and not effects:
            raise InputError(f"{path}: found no effect that another recording could be held against; drop physics_from")
        return cls(recording, effects, errors, units, density, tuple(sorted(set(found) - set(taken))), noise)


def with_declared(model: Mapping, path: str | Path | None) -> dict:
    """A recording's model in which what another one's diagnosis found, or was told and fitted, is declared.

    Parameters
    ----------
    model : mapping
        As study.diagnosis_jobs.Diagnosis.model gives it.
    path : str, Path or None
        A diagnosis.json; None: the model as it is.

    Returns
    -------
    dict
        Its settings' baseline has value and sd of these too, where it does not state the effect itself. Parameters of
        one scan are taken for neutral, to within what they were there.

    Raises
    ------
    InputError
        As `Physics.read` does, and if that diagnosis knows no effect.
    """
    if path is None:
        return dict(model)
    found = Physics.read(path, needed=False)
    known = {
        name: {key: {"value": value, "sd": found.errors[name][key]} for key, value in values.items()}
        for name, values in found.effects.items()
    }
    for name, values in read_document(path, DIAGNOSIS).get("declared", {}).items():
        known[name] = {key: {"value": one["value"], "sd": _error(one)} for key, one in values.items()}
    for name, values in known.items():
        for key, neutral in of_one_scan(name).items():
            if key in values:
                values[key] = {"value": neutral, "sd": abs(values[key]["value"] - neutral) + values[key]["sd"]}
    if not known:
        raise InputError(f"{path}: knows no effect of the scanner; take baseline_from out")
    settings = model["settings"]
    return {**model, "settings": {**settings, "baseline": {**known, **settings.get("baseline", {})}}}


def _error(parameter: dict, interval: str = "ci95") -> float:
    """The longer side: at a bound of the plausible range the other was cut."""
    low, high = parameter.get(interval, parameter["ci95"])
    return max(high - parameter["value"], parameter["value"] - low) / NORMAL_95


def verified(fitter: Fitter, baseline: Trial, physics: Physics, same_material: bool) -> Choice:
    """Fit the alignment, and parameters of one scan, beside physics found elsewhere.

    An effect's gain is what data that were not fitted lose without it, the others kept and the alignment refitted. As
    nothing of an effect was fitted here, it has no p-value (None).

    Parameters
    ----------
    baseline : Trial
        The simulator with nothing but alignment.
    same_material : bool
        The object is of the material that the other one was of: with a spectrum, the scale is its density and is held
        where it was found, within its error.

    Raises
    ------
    InputError
        For a parameter in a unit that this recording does not have.
    """
    for name, units in physics.units.items():
        counted = {one.name for one in load(name).parameters if READOUT_UNITS in one.unit}
        for one in fitter.model.parameters(name):
            if one.name in counted & units.keys() and units[one.name] != one.unit:
                raise InputError(
                    f"{physics.recording}: {one.name} of its {name} is in {units[one.name]}, and this recording's in "
                    f"{one.unit}; take the physics from a recording of the same kind"
                )
    model = fitter.model
    density = physics.scale if physics.scale is not None and same_material else model.density
    held = fitter.of(copy.copy(model))  # of projections or of images
    held.model.fixed = {name: those(NOT_OF_SCAN, name, values) for name, values in physics.effects.items()}
    held.model.density = density
    chosen = trial(held, tuple(physics.effects), baseline)
    without = {}
    for name in physics.effects:
        rest = tuple(other for other in physics.effects if other != name)
        without[name] = trial(held, rest, chosen) if rest else baseline
    gains = {name: chosen.score - one.score for name, one in without.items()}
    whole, noise = (
        {name: chosen.fit.errors[name] | those(NOT_OF_SCAN, name, values) for name, values in errors.items()}
        for errors in (physics.errors, physics.errors | physics.noise)
    )
    chosen = replace(chosen, fit=replace(chosen.fit, errors=noise))
    errors = Errors(whole, chosen.fit.nuisance_errors)
    fits = {name: one.fit for name, one in without.items()}
    numerical = defaults_of("diagnosis", "model_accuracy")["numerical"]
    p = dict.fromkeys(physics.effects)
    return Choice(baseline, {}, {}, chosen, gains, {}, p, without=fits, numerical=numerical, errors=errors)


def stated(content: dict, physics: Physics) -> dict:
    """What diagnosis.json holds, with where the physics is from."""
    content = content | {
        "effects": [one | {"taken_from": physics.recording} for one in content["effects"]],
        "not_taken": list(physics.not_taken),
    }
    return content | {"sentence": sentence(content)}
