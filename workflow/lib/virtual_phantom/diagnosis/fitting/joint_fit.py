"""Joint fit of several recordings of one scanner: they share its physics, and each has its own nuisance parameters."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from ...base.errors import InputError
from ...physics.effect import OF_PROTOCOL, OF_SCANNER, load, scan_parameters
from .fit import Fit, Fitter
from .problem import Problem
from .solver import JointProblem, solve
from .steps import ScaledEigenvalues, standard_errors

NOT_OF_SCAN = (OF_SCANNER, OF_PROTOCOL)


@dataclass(frozen=True)
class JointFit:
    """Fit to all recordings together.

    Attributes
    ----------
    effects : tuple of str
        In the order given.
    physics : dict of str to dict of str to float
        {effect: {parameter: value}}, shared by all recordings. Parameters of a single scan are neutral. Parameters of a
        protocol are those of the first recording's protocol.
    chi_square : float
        Chi-square of all fitted data and the priors.
    free : int
        Number of fitted parameters of effects. Parameters of one scan count once per recording, and parameters of one
        protocol once per protocol.
    fits : dict of str to Fit
        By recording, with its own nuisance parameters and its own parameters of one scan or protocol.
    """

    effects: tuple[str, ...]
    physics: dict[str, dict[str, float]]
    chi_square: float
    free: int
    fits: dict[str, Fit]

    @property
    def deviance(self) -> float:
        """As Fit.deviance."""
        return self.chi_square + sum(fit.deviance - fit.chi_square for fit in self.fits.values())


class JointFitter:
    """Joint fits of several recordings.

    Parameters
    ----------
    protocols : mapping of str to str, optional
        Protocol of each recording. Recordings without a stated protocol have one protocol in common.

    Raises
    ------
    InputError
        If there is no recording.
    """

    def __init__(self, fitters: Mapping[str, Fitter], protocols: Mapping[str, str] | None = None):
        if not fitters:
            raise InputError("a joint fit needs a recording; there is none")
        self.fitters = dict(fitters)
        self.protocols = {name: (protocols or {}).get(name, "") for name in self.fitters}

    def with_declared_effects(self, effects: tuple[str, ...]) -> tuple[str, ...]:
        """Return the scanner's declared effects followed by these."""
        return next(iter(self.fitters.values())).model.with_declared_effects(effects)

    def without(self, names: Collection[str]) -> JointFitter:
        """Return the fitter of the other recordings."""
        return JointFitter({name: fitter for name, fitter in self.fitters.items() if name not in names}, self.protocols)

    def fit(self, effects: tuple[str, ...], given: JointFit | None = None) -> JointFit:
        """Fit all parameters of these effects, and the nuisance parameters of every recording.

        With a new effect, physics starts from a fit to the first recording alone, because that fit tries all starts. If
        an effect has parameters of a protocol, this is done for each protocol.

        Parameters
        ----------
        given : JointFit, optional
            Starting point; it may include further recordings.

        Raises
        ------
        InputError
            For a gain pattern, which belongs to one scan.
        """
        for name in effects:
            if load(name).pattern:
                raise InputError(f"{name} has one unknown per detector pixel of one scan; recordings cannot share it")
        starts = {
            name: given.fits[name] if given is not None and name in given.fits else fitter.fit(())
            for name, fitter in self.fitters.items()
        }
        if given is None or set(effects) - set(given.effects):
            alone: dict[str, Fit] = {}
            for name, fit in starts.items():
                if (protocol := self._protocol(name, effects)) not in alone:
                    alone[protocol] = self.fitters[name].fit(effects, fit, final=False)
                starts[name] = replace(fit, effects=effects, physics=alone[protocol].physics)
        problems = {name: Problem(self.fitters[name], effects, fit) for name, fit in starts.items()}
        return self._solve(JointProblem(problems, self.protocols))

    def _solve(self, problem: JointProblem) -> JointFit:
        found = solve(problem, problem.common_start())
        information = found.information
        if information is None:
            information, _ = problem.normal(problem.jacobians(found), found)
        errors, root, fits = standard_errors(information), ScaledEigenvalues.of(information).root, {}
        for name, own, part in problem.parts(found.point):
            indices = problem.indices[name]
            fit = Fit.at(own, part, errors[indices], found.residuals[name])
            directions: dict[str, dict[str, list[float]]] = {}
            for unknown, index in zip(own.unknowns, indices, strict=False):
                directions.setdefault(unknown.effect, {})[unknown.name] = root[index].tolist()
            fits[name] = replace(fit, directions=directions)
        first = next(iter(fits.values()))
        physics = {name: {**values, **scan_parameters(name)} for name, values in first.physics.items()}
        free = len(found.point) - sum(len(own.nuisances) for own in problem.problems.values())
        return JointFit(first.effects, physics, found.chi_square, free, fits)

    def left_out(self, names: Collection[str], given: JointFit) -> dict[str, Fit]:
        """Fit recordings with physics that was fitted to the others, starting from a joint fit.

        Nuisance parameters and parameters of one scan are fitted. So are parameters of a protocol that none of the
        others has. Declared physics also has the values fitted to the others.
        """
        if not self.with_declared_effects(given.effects):
            return {name: given.fits[name] for name in names}
        others = self.without(names).fit(given.effects, given)
        return self.fit_with_fixed_physics(others, {name: given.fits[name] for name in names})

    def fit_with_fixed_physics(self, others: JointFit, starts: Mapping[str, Fit]) -> dict[str, Fit]:
        """Fit recordings with physics that was fitted to others, as `left_out` does."""
        return {name: self._fit_one_with_fixed_physics(name, start, others) for name, start in starts.items()}

    def _fit_one_with_fixed_physics(self, name: str, start: Fit, others: JointFit) -> Fit:
        """Fit one recording with physics that was fitted to others."""
        fitter, effects = self.fitters[name], others.effects
        rest = [other for other in self.fitters if other in others.fits]
        alike = [other for other in rest if self.protocols[other] == self.protocols[name]]
        owners = NOT_OF_SCAN if alike else (OF_SCANNER,)
        source = others.fits[(alike or rest)[0]]
        whole = self.with_declared_effects(effects)
        fixed = {effect: parameters_owned_by(owners, effect, source.physics[effect]) for effect in whole}
        physics, errors = {}, {}
        for effect in whole:
            own = start.physics.get(effect, {})
            physics[effect] = others.physics[effect] | own | fixed[effect]
            errors[effect] = parameters_owned_by(owners, effect, source.errors[effect])
        fixed_fitter = fitter.of(fitter.model.with_fixed(fixed))
        fit = fixed_fitter.fit(effects, replace(start, effects=effects, physics=physics))
        errors = {effect: fit.errors[effect] | errors[effect] for effect in whole}
        return replace(fit, errors=errors, directions=source.directions)

    def _protocol(self, name: str, effects: tuple[str, ...]) -> str:
        """Return a recording's protocol if one of these effects has parameters of a protocol."""
        own = any(parameter.belongs_to == OF_PROTOCOL for effect in effects for parameter in load(effect).parameters)
        return self.protocols[name] if own else ""


def parameters_owned_by(owners: Collection[str], name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values (or errors) of those parameters of the effect `name` that belong to one of `owners`."""
    own = {parameter.name for parameter in load(name).parameters if parameter.belongs_to in owners}
    return {key: value for key, value in values.items() if key in own}
