"""Compute standard errors of fitted parameters that include errors of the models of effects.

An inexact model biases parameters whose statistical errors are small [1]_. The model of an effect may be wrong by a
fraction of the change that it explains (`model_accuracy`). This error may be uniform, or rise along an axis of the data
or with the attenuation. A blur kernel or a focal spot may have another form than assumed. Corrections for
discretization may vary along axes, with the attenuation, and with the direction of view. The selection of effects uses
the same fractions.

Data of noise that the fit does not explain, such as a variance without electronic noise, bias parameters. The bias
grows if errors of the object leave the parameters less constrained. Such data get the errors by which their chi-square
equals their number [2]_, and the resulting shift of the parameters is one more standard error.

References
----------
.. [1] J. Brynjarsdottir and A. O'Hagan, Inverse Problems 30, 114007, 2014.
.. [2] R. T. Birge, Phys. Rev. 40, 207, 1932.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from ...physics.effect import Parameter, load
from ..fitting.fit import Fit, Fitter
from ..fitting.joint_fit import JointFit, JointFitter
from ..fitting.problem import Problem
from ..fitting.solver import joint_indices
from ..fitting.steps import ScaledEigenvalues, standard_errors
from ..fitting.templates import data_changes, whitened
from ..residuals.residual_tests import ALPHA

Distortions = Iterator[tuple[tuple[str, int | str], np.ndarray]]  # (model, shape), and (data,)
# Key of model_accuracy: variation of discretization corrections, relative to the change by half the step size.
NUMERICAL = "numerical"
# Relative width of the part of a kernel that has another form than assumed (Parameter.kernel_error).
NARROWER = 0.5
UNEXPLAINED = "unexplained"  # among the models of ModelErrorInfluence.gradients
HARMONICS = (2, 4)  # periods per turn: an object looks equal from opposite sides, a square grid from four


@dataclass(frozen=True)
class Errors:
    """Standard errors of fitted parameters with model errors, in the form of Fit.errors and Fit.nuisance_errors."""

    physics: dict[str, dict[str, float]]
    nuisance: dict[str, float]


def errors_with_models(fitter: Fitter, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float]) -> Errors:
    """Return standard errors of fitted parameters with model errors.

    A model error d of the whitened data shifts the parameters by A^-1 J'd. Here J is the Jacobian of the data, and
    A = J'J + K the information matrix with priors. Model errors are independent of each other and of noise.

    Parameters
    ----------
    without : mapping of str to Fit
        {effect: fit without it}, for effects with inexact models: the difference is what the effect explains.
    accuracy : mapping of str to float
        As `forward_selection.choose` takes it.
    """
    problem = Problem.at(fitter, fit)
    found = (_distortions(problem, fit, without, accuracy), _of_steps(problem, fit, accuracy))
    exact = all(next(distortions, None) is None for distortions in found)
    # Derivatives of images take minutes.
    if exact and (birge_ratios(problem.residuals(problem.start), problem.weights) == 1).all():
        return Errors({name: dict(errors) for name, errors in fit.errors.items()}, dict(fit.nuisance_errors))
    numbers = _numbers([ModelErrorInfluence.of(problem, fit, without, accuracy, np.arange(len(problem.start)))])
    names = [number.name for number in problem.nuisances]
    return Errors(
        _named(problem, fit, numbers),
        fit.nuisance_errors | dict(zip(names, map(float, numbers[len(problem.unknowns) :]), strict=True)),
    )


def joint_errors_with_models(
    scans: Mapping[str, ModelErrorInfluence], fits: Mapping[str, Fit] | None = None
) -> dict[str, dict[str, dict[str, float]]]:
    """Return standard errors of effects' parameters in a joint fit, with model errors, by recording.

    The method is as in errors_with_models. Recordings share the models of effects, so more recordings do not reduce
    model errors. Discretization errors are independent between recordings.

    Parameters
    ----------
    fits : mapping of str to Fit, optional
        Fits whose errors are returned, with the Jacobians of the fits in `scans`; None: the fits in `scans`.
    """
    numbers = _numbers(list(scans.values()))
    fits = fits or {name: scan.fit for name, scan in scans.items()}
    return {name: _named(scan.problem, fits[name], numbers[scan.places]) for name, scan in scans.items()}


def influences_of_recordings(
    together: JointFitter, fit: JointFit, without: Mapping[str, JointFit], accuracy: Mapping[str, float]
) -> dict[str, ModelErrorInfluence]:
    """Return the information of each recording on the joint parameters, and the influence of model errors."""
    problems = {name: Problem.at(fitter, fit.fits[name]) for name, fitter in together.fitters.items()}
    places = joint_indices(problems, together.protocols)
    return {
        name: ModelErrorInfluence.of(
            problem, fit.fits[name], {key: other.fits[name] for key, other in without.items()}, accuracy, places[name]
        )
        for name, problem in problems.items()
    }


def distortions_of_physics(
    fitter: Fitter, fit: Fit, columns: np.ndarray, accuracy: Mapping[str, float], names: Sequence[str]
) -> np.ndarray:
    """Return changes of the whitened data by errors of effects' models, shape (data, distortions).

    Each is one standard deviation. The error is a share of the change by the effect. For a declared effect, the part
    that the nuisance parameters would absorb without it is subtracted, to first order. Effects that only move rays or
    the object have no model error. If effects are fitted, non-uniform discretization errors are included.

    Parameters
    ----------
    columns : ndarray, shape (data, numbers)
        From `data_changes`, of the fit.
    accuracy : mapping of str to float
        As `forward_selection.choose` takes it.
    """
    problem, here = Problem.at(fitter, fit), fitter.predicted(fit)
    parts, spread, first = fitter.data.residuals(here), shapes(here.mean), len(problem.unknowns)
    found = []
    for name in names:
        share = accuracy.get(name, accuracy["default"])
        if not share or load(name).kinematic or load(name).pattern:
            continue
        other = fitter.of(fitter.model.undeclared(name)) if name in fitter.model.declared else fitter
        physics = {key: values for key, values in fit.physics.items() if key != name}
        there = other.model.predict(physics, fit.nuisance, fitter.data, fit.linearization)
        change = [one - part for one, part in zip(fitter.data.residuals(there), parts, strict=True)]
        if name not in fit.effects:
            prior_precision = Problem.at(other, fit).prior_precision[-len(problem.nuisances) :]
            numbers = np.vstack([columns[:, first:], np.diag(np.sqrt(prior_precision))])
            known = np.concatenate([problem.whitened(change), np.zeros(len(prior_precision))])
            amounts = np.linalg.lstsq(numbers, known, rcond=None)[0] / problem.steps[first:]
            rows = problem.changes_at_start()
            change = [part - amounts @ row[first:] for part, row in zip(change, rows, strict=True)]
        mean, *rest = [share * part for part in change]
        for shape in spread.values():
            found.append(problem.whitened([mean * shape.ravel(), *rest]))
            rest = [np.zeros_like(part) for part in rest]  # other parts of the data change only with the uniform shape
        if name in fit.effects:
            found += [change for _, change in _of_kernels(problem, fit, name, parts, share)]
    if set(names) & set(fit.effects):
        found += [change for _, change in _of_steps(problem, fit, accuracy)]
    return np.stack(found, axis=1) if found else np.zeros((len(columns), 0))


def shapes(level: np.ndarray) -> dict[int, np.ndarray]:
    """Return the shapes of a model error over data along three axes, by number, with a root mean square of 1.

    Shape 0 is uniform; others change linearly or quadratically along an axis or with the level. An axis of length one
    has none.
    """
    axes = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in level.shape), indexing="ij", sparse=True)
    rising = [*axes, level, axes[2] ** 2, (level - level.mean()) ** 2]
    found = {0: np.ones(level.shape)}
    for number, values in enumerate(rising, start=1):
        shape = np.broadcast_to(values - values.mean(), level.shape)
        spread = shape.std()
        if spread > 0:
            found[number] = shape / spread
    return found


def harmonics(angles_rad: np.ndarray | None, shape: tuple[int, int, int]) -> dict[str, np.ndarray]:
    """Return waves over a turn, with an RMS of 1, by name: errors of a grid may vary so with the viewing direction."""
    if angles_rad is None:
        return {}
    waves = {f"{wave.__name__} {times}": wave(times * angles_rad) for times in HARMONICS for wave in (np.cos, np.sin)}
    sizes = {name: np.sqrt(np.mean(wave**2)) for name, wave in waves.items()}
    return {
        name: np.broadcast_to((wave / sizes[name])[:, None, None], shape)
        for name, wave in waves.items()
        if sizes[name] > 0
    }


@dataclass(frozen=True)
class ModelErrorInfluence:
    """Information of one recording on the fitted numbers, and the influence of model errors on them.

    Attributes
    ----------
    problem : Problem
        At the end of `fit`.
    places : ndarray of int, shape (numbers,)
        Positions of its numbers among the numbers of all recordings.
    information : ndarray, shape (numbers, numbers)
        Information of its data, without priors.
    gradients : dict of (str, int or str) to ndarray, shape (numbers,)
        {(model, shape): change J'd of the gradient}, and {(UNEXPLAINED, 0): its change if these data get larger
        errors}.
    own_gradients : list of ndarray, shape (numbers,)
        The same for model errors that are specific to this recording.
    """

    problem: Problem
    fit: Fit
    places: np.ndarray
    information: np.ndarray
    gradients: dict[tuple[str, int | str], np.ndarray]
    own_gradients: list[np.ndarray]

    @classmethod
    def of(
        cls, problem: Problem, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float], places: np.ndarray
    ) -> ModelErrorInfluence:
        """Compute the influence for a problem at the end of a fit."""
        changes, residuals = data_changes(problem), problem.residuals(problem.start)
        ratios = birge_ratios(residuals, problem.weights)
        weighted, gradients = changes, {}
        if (ratios > 1).any():
            weighted, residual = changes / ratios[:, None], whitened(residuals, problem.weights)
            # The gradient is 0 at the end of a fit, apart from numbers at a bound.
            at_bound = (problem.start <= problem.low) | (problem.start >= problem.high)
            gradient = residual @ changes + problem.prior_precision * (problem.center - problem.start)
            gradients[UNEXPLAINED, 0] = residual @ (weighted - changes) + np.where(at_bound, gradient, 0)
        information = weighted.T @ changes
        gradients |= {key: weighted.T @ change for key, change in _distortions(problem, fit, without, accuracy)}
        own = [weighted.T @ change for _, change in _of_steps(problem, fit, accuracy)]
        return cls(problem, fit, places, information, gradients, own)

    @property
    def alone(self) -> ModelErrorInfluence:
        """The same for this recording alone, without joint numbering."""
        return replace(self, places=np.arange(len(self.places)))


def birge_ratios(residuals: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """Return chi-square over the number of data in each part of the data, for every datum, shape (data,).

    It is 1 for the mean, and for parts whose chi-square is not significantly larger.
    """
    found = [np.ones(residuals[0].size)]
    for residual, weight in zip(residuals[1:], weights[1:], strict=True):
        count, chi_square = int((weight > 0).sum()), float((weight * residual**2).sum())
        unexplained = count and stats.chi2.sf(chi_square, count) < ALPHA
        found.append(np.full(residual.size, chi_square / count if unexplained else 1.0))
    return np.concatenate(found)


def _numbers(scans: Sequence[ModelErrorInfluence]) -> np.ndarray:
    """Return standard errors of all numbers of several recordings, shape (numbers,)."""
    count = 1 + max(int(scan.places.max()) for scan in scans)
    information, prior_precision = np.zeros((count, count)), np.zeros(count)
    times = np.bincount(np.concatenate([scan.places for scan in scans]), minlength=count)
    gradients: dict[tuple[str, int | str], np.ndarray] = {}
    own: list[np.ndarray] = []
    for scan in scans:
        places = scan.places
        information[np.ix_(places, places)] += scan.information
        # The prior of a shared number counts once: it is the mean over the recordings.
        prior_precision[places] += scan.problem.prior_precision / times[places]
        for key, gradient in scan.gradients.items():
            gradients.setdefault(key, np.zeros(count))[places] += gradient
        for gradient in scan.own_gradients:
            own.append(np.zeros(count))
            own[-1][places] = gradient
    information += np.diag(prior_precision)
    root, squares = ScaledEigenvalues.of(information).root, standard_errors(information) ** 2
    for gradient in (*gradients.values(), *own):
        squares = squares + (root @ (root.T @ gradient)) ** 2
    return np.sqrt(squares)


def _named(problem: Problem, fit: Fit, numbers: np.ndarray) -> dict[str, dict[str, float]]:
    """Return standard errors of a fit's parameters by name; parameters that are not fitted keep their errors."""
    errors = {name: dict(errors) for name, errors in fit.errors.items()}
    for unknown, error in zip(problem.unknowns, numbers, strict=False):
        number = unknown.of(fit.physics[unknown.effect][unknown.name])
        errors[unknown.effect][unknown.name] = float(unknown.value_error(number, error))
    return errors


def _distortions(problem: Problem, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float]) -> Distortions:
    """Yield changes of the whitened data by model errors, one standard deviation each."""
    # They are yielded one at a time, because the memory does not hold all changes of a large scan.
    fitter, data, here = problem.fitter, problem.data, problem.fitter.predicted(fit)
    after, spread = data.residuals(here), shapes(here.mean)
    for name, fitted in without.items():
        if load(name).pattern or load(name).kinematic:  # they have no model error
            continue
        share, there = accuracy.get(name, accuracy["default"]), fitter.predicted(fitted)
        rest = [share * (part - other) for part, other in zip(data.residuals(there), after, strict=True)][1:]
        change = share * (here.mean - there.mean)
        for number, shape in spread.items():  # other parts of the data change only with shape 0
            yield (name, number), _whole(problem, change * shape, rest)
            rest = [np.zeros_like(part) for part in rest]
        yield from _of_kernels(problem, fit, name, after, share)


def _of_kernels(problem: Problem, fit: Fit, name: str, after: Sequence[np.ndarray], share: float) -> Distortions:
    """Yield changes by kernels of another form than assumed; `after` are the fit's residuals by part."""
    fitter = problem.fitter
    for parameter in load(name).parameters:
        error = kernel_error(parameter, share)
        if error:
            narrower = {parameter.name: NARROWER * fit.physics[name][parameter.name]}
            physics = fit.physics | {name: fit.physics[name] | narrower}
            there = fitter.model.predict(physics, fit.nuisance, fitter.data, fit.linearization)
            parts = [part - other for part, other in zip(fitter.data.residuals(there), after, strict=True)]
            yield (name, parameter.name), error * problem.whitened(parts)


def kernel_error(parameter: Parameter, share: float) -> float:
    """Return Parameter.kernel_error, or `share`, the relative error of the effect's model; 0 without a kernel."""
    own = share if parameter.kernel_error is None else parameter.kernel_error
    return own if parameter.kernel else 0.0


def _of_steps(problem: Problem, fit: Fit, accuracy: Mapping[str, float]) -> Distortions:
    """Yield changes by non-uniform discretization errors; the size of uniform ones is fitted."""
    share, fitter, data = accuracy.get(NUMERICAL, 0.0), problem.fitter, problem.data
    errors = fitter.model.discretization_errors(fit.linearization) if share else {}
    if not errors:
        return
    here = fitter.predicted(fit)
    none = [np.zeros_like(part) for part in data.residuals(here)[1:]]
    spread = {key: shape for key, shape in shapes(here.mean).items() if key != 0}
    spread |= harmonics(fitter.model.source_angles_rad, here.mean.shape)
    for name, change in errors.items():
        for key, shape in spread.items():
            yield (name, key), _whole(problem, share * change * shape, none)


def _whole(problem: Problem, change: np.ndarray, rest: list[np.ndarray]) -> np.ndarray:
    """Return a change of the mean and of the other parts of the data, whitened."""
    return problem.whitened([problem.data.whitened(change).ravel(), *rest])
