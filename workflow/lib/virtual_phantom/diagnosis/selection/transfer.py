"""Test the physics found in one recording on another recording of the same scanner.

Only the nuisance parameters and the parameters that belong to a single scan are fitted to the other recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...base.errors import InputError, refusing
from ...io.documents import DIAGNOSIS, read_document
from ...physics.effect import READOUT_UNITS, absolute_attenuation, checked, load, scan_parameters
from ..fitting.fit import Fitter
from ..fitting.joint_fit import NOT_OF_SCAN, parameters_owned_by
from ..fitting.steps import NORMAL_95
from ..fitting.trial import Trial, trial
from ..settings import FitSettings
from ..uncertainty.model_error import Errors
from .forward_selection import Choice, without_effect


@dataclass(frozen=True)
class Physics:
    """Physics that a diagnosis found.

    Attributes
    ----------
    effects, errors : dict of str to dict of str to float
        {effect: {parameter: value}}, and standard errors with model errors.
    units : dict of str to dict of str to str
        {effect: {parameter: unit}}.
    scale : tuple of 2 float, or None
        Density scale and its standard error, if an effect determines attenuation absolutely.
    not_taken : tuple of str
        Effects that apply to one scan only: patterns of its pixels, which are not in diagnosis.json.
    noise : dict of str to dict of str to float
        Standard errors for noise alone, where they differ from `errors`.
    """

    recording: str
    effects: dict[str, dict[str, float]]
    errors: dict[str, dict[str, float]]
    units: dict[str, dict[str, str]]
    scale: tuple[float, float] | None
    not_taken: tuple[str, ...]
    noise: dict[str, dict[str, float]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: str | Path, allow_empty: bool = False) -> Physics:
        """Read a diagnosis.json.

        Raises
        ------
        InputError
            If it is missing or broken, or found no effect, unless `allow_empty`.
        """
        kinds = (OSError, ValueError, KeyError, TypeError)
        with refusing(f"{path}: is no diagnosis", *kinds, advice="run the diagnosis again"):
            content = read_document(path, DIAGNOSIS)
            if "alignment" not in content:  # nothing was fitted
                raise InputError(f"{path}: {content['sentence']} No physics was fitted; correct this first")
            found = {effect["name"]: effect["parameters"] for effect in content["effects"]}
            recording, scale = content["recording"], content["alignment"]["scale"]
            taken = {name: values for name, values in found.items() if not load(name).pattern}
            effects = checked({n: {k: v["value"] for k, v in values.items()} for n, values in taken.items()}, str(path))
            errors = {n: {k: _error(v) for k, v in values.items()} for n, values in taken.items()}
            noise = {n: {k: _error(v, "ci95_noise") for k, v in values.items()} for n, values in taken.items()}
            units = {n: {k: v["unit"] for k, v in values.items()} for n, values in taken.items()}
            density = (scale["value"], _error(scale)) if absolute_attenuation(effects) else None
        if not (allow_empty or effects):
            raise InputError(f"{path}: found no effect to test on another recording; remove physics_from")
        return cls(recording, effects, errors, units, density, tuple(sorted(set(found) - set(taken))), noise)


def with_declared(model: FitSettings, path: str | Path | None) -> FitSettings:
    """Return the settings of a fit with the effects of another recording's diagnosis added to its baseline.

    All effects that the other diagnosis found or declared are added with value and SD, except effects that the
    baseline has already. Parameters of one scan get their neutral value, with an SD that includes their value in the
    other scan.

    Parameters
    ----------
    path : str, Path or None
        A diagnosis.json. None: the model is returned unchanged.

    Raises
    ------
    InputError
        As `Physics.read`, and if that diagnosis has no effect.
    """
    if path is None:
        return model
    found = Physics.read(path, allow_empty=True)
    known = {
        name: {key: {"value": value, "sd": found.errors[name][key]} for key, value in values.items()}
        for name, values in found.effects.items()
    }
    for name, values in read_document(path, DIAGNOSIS).get("declared", {}).items():
        known[name] = {key: {"value": prior["value"], "sd": _error(prior)} for key, prior in values.items()}
    for name, values in known.items():
        for key, neutral in scan_parameters(name).items():
            if key in values:
                values[key] = {"value": neutral, "sd": abs(values[key]["value"] - neutral) + values[key]["sd"]}
    if not known:
        raise InputError(f"{path}: has no effect of the scanner; remove baseline_from")
    return replace(model, settings=replace(model.settings, baseline=known | model.settings.baseline))


def _error(parameter: dict, interval: str = "ci95") -> float:
    """Return the standard error from the longer side of an interval, as the other side may end at a bound."""
    low, high = parameter.get(interval, parameter["ci95"])
    return max(high - parameter["value"], parameter["value"] - low) / NORMAL_95


def fit_with_fixed_physics(
    fitter: Fitter, baseline: Trial, physics: Physics, same_material: bool, numerical: float = 0.0
) -> Choice:
    """Fit nuisance parameters and parameters of one scan, with the physics of another recording fixed.

    The gain of an effect is the loss of held-out log score without it, with the other effects kept and the nuisance
    parameters refitted. Its p-value is None, because the effect is not fitted to this recording.

    Parameters
    ----------
    baseline : Trial
        Nuisance parameters alone.
    same_material : bool
        Whether both objects have the same material. If attenuation is absolute, the density scale of the other
        recording is then the prior.
    numerical : float, optional
        Relative error of discretization corrections (`diagnosis.model_accuracy.numerical`).

    Raises
    ------
    InputError
        If a parameter has another unit in this recording.
    """
    for name, units in physics.units.items():
        counted = {parameter.name for parameter in load(name).parameters if READOUT_UNITS in parameter.unit}
        for parameter in fitter.model.parameters(name):
            if parameter.name in counted & units.keys() and units[parameter.name] != parameter.unit:
                raise InputError(
                    f"{physics.recording}: {parameter.name} of its {name} is in {units[parameter.name]}, and this "
                    f"recording's in {parameter.unit}; take the physics from a recording of the same kind"
                )
    density = physics.scale if same_material else None
    fixed = fitter.of(fitter.model.with_fixed(_without_scan_parameters(physics.effects), density))
    chosen = trial(fixed, tuple(physics.effects), baseline)
    without = {}
    for name in physics.effects:
        rest = without_effect(tuple(physics.effects), name)
        without[name] = trial(fixed, rest, chosen) if rest else baseline
    gains = {name: chosen.score - rest.score for name, rest in without.items()}
    total, noise = (
        {name: chosen.fit.errors[name] | values for name, values in _without_scan_parameters(errors).items()}
        for errors in (physics.errors, physics.errors | physics.noise)
    )
    chosen = replace(chosen, fit=replace(chosen.fit, errors=noise))
    errors = Errors(total, chosen.fit.nuisance_errors)
    fits = {name: rest.fit for name, rest in without.items()}
    p = dict.fromkeys(physics.effects)
    return Choice(baseline, chosen, gains=gains, p=p, without=fits, numerical=numerical, errors=errors)


def _without_scan_parameters(physics: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return {effect: {parameter: value}} without the parameters that belong to one scan."""
    return {name: parameters_owned_by(NOT_OF_SCAN, name, values) for name, values in physics.items()}


def with_physics_source(content: dict, physics: Physics) -> dict:
    """Return the content of diagnosis.json with the source of the physics; the lines of the verdict do not change."""
    return content | {
        "effects": [effect | {"taken_from": physics.recording} for effect in content["effects"]],
        "not_taken": list(physics.not_taken),
    }
