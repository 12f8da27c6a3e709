"""By how much a fit's numbers may be off because its models are inexact, beside what noise does.

A wrong model shifts numbers that seem well known [1]_. Here a model of an effect may be wrong by a share of what it
explains (`model_accuracy`): as a whole, or rising along an axis of the data or with the attenuation. A kernel or a
source may have another form than was assumed. Corrections for finite steps may be uneven: along axes, with the
attenuation, and with the direction from which a grid and an object are seen. The same shares guard the choice of
effects.

References
----------
.. [1] J. Brynjarsdottir and A. O'Hagan, Inverse Problems 30, 114007, 2014.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...physics.effect import load
from ..fitting.fit import Fit, Fitter, Problem
from ..fitting.joint_fit import JointFit, JointFitter, places_of
from ..fitting.steps import Known, standard_errors
from ..fitting.templates import data_changes, whitened

Distortions = Iterator[tuple[tuple[str, int | str], np.ndarray]]  # (model, shape), and (data,)
NUMERICAL = "numerical"  # of model_accuracy: how uneven corrections are, over what a twice finer step changes
# Of a kernel whose form is assumed: a share of it may be narrower by the second, one standard deviation of which is the
# model's inexactness, but for these. In six scans of off-focal radiation (benchmarks/intervals.py, seeds 71 and 72) 41
# to 74 % of it were found, which is off by 1.1 of as much again as was found, half as wide, root mean square.
MIXED, NARROWER = {"off_focal_radiation": 1.0}, 0.5
HARMONICS = (2, 4)  # of a turn: an object is seen alike from opposite sides, a square grid from four


@dataclass(frozen=True)
class Errors:
    """Standard errors of a fit's numbers, inexact models included.

    Attributes
    ----------
    physics : dict of str to dict of str to float
        {effect: {parameter: standard error}}, as Fit.errors.
    nuisance : dict of str to float
        As Fit.nuisance_errors.
    """

    physics: dict[str, dict[str, float]]
    nuisance: dict[str, float]


def errors_with_models(fitter: Fitter, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float]) -> Errors:
    """Standard errors of a fit's numbers, inexact models included.

    A distortion d of the whitened data shifts the numbers by A^-1 J'd, where J are the changes of the data per number
    and A = J'J + K their information and what is known of them. Distortions are independent of each other and of noise.

    Parameters
    ----------
    without : mapping of str to Fit
        {effect: the fit without it}, of those whose models may be inexact: what an effect explains is by how much these
        differ.
    accuracy : mapping of str to float
        As `attribute.choose` takes it.
    """
    found = (_distortions(fitter, fit, without, accuracy), _of_steps(fitter, fit, accuracy))
    if all(next(one, None) is None for one in found):  # of images, derivatives take minutes
        return Errors({name: dict(one) for name, one in fit.errors.items()}, dict(fit.nuisance_errors))
    problem = Problem(fitter, fit.effects, fit)
    numbers = _numbers([ModelErrorInfluence.of(problem, fit, without, accuracy, np.arange(len(problem.start)))])
    names = [one.name for one in problem.aligned]
    return Errors(
        _named(problem, fit, numbers),
        fit.nuisance_errors | dict(zip(names, map(float, numbers[len(problem.unknowns) :]), strict=True)),
    )


def errors_of_pulled(
    scans: Mapping[str, ModelErrorInfluence], fits: Mapping[str, Fit] | None = None
) -> dict[str, dict[str, dict[str, float]]]:
    """Standard errors of effects' parameters that are fitted to these recordings together, inexact models included.

    As errors_with_models; one distortion is that of one model and one shape, in all recordings at once: they have the
    same model, so that more of them do not make its error less. Finite steps err in every recording for itself.

    Parameters
    ----------
    scans : mapping of str to ModelErrorInfluence
        By recording.
    fits : mapping of str to Fit, optional
        Whose errors they are, by the slopes of those that were looked at; None: of these themselves.

    Returns
    -------
    dict of str to dict of str to dict of str to float
        {recording: as Fit.errors}.
    """
    numbers = _numbers(list(scans.values()))
    fits = fits or {name: one.fit for name, one in scans.items()}
    return {name: _named(one.problem, fits[name], numbers[one.places]) for name, one in scans.items()}


def pulled_of_recordings(
    together: JointFitter, fit: JointFit, without: Mapping[str, JointFit], accuracy: Mapping[str, float]
) -> dict[str, ModelErrorInfluence]:
    """What each recording knows of the numbers of all, and how inexact models pull them.

    Parameters
    ----------
    fit : JointFit
        Where it ended.
    without : mapping of str to JointFit
        As errors_with_models takes them.
    accuracy : mapping of str to float
        As errors_with_models takes it.

    Returns
    -------
    dict of str to Pulled
        By recording.
    """
    problems = {name: Problem(fitter, fit.effects, fit.fits[name]) for name, fitter in together.fitters.items()}
    places = places_of(problems, together.protocols)
    return {
        name: ModelErrorInfluence.of(
            one,
            fit.fits[name],
            {key: other.fits[name] for key, other in without.items()},
            accuracy,
            places[name],
        )
        for name, one in problems.items()
    }


def distortions_of_physics(
    fitter: Fitter, fit: Fit, columns: np.ndarray, accuracy: Mapping[str, float], names: Sequence[str]
) -> np.ndarray:
    """Changes of the whitened data that inexact models of declared or fitted physics may make.

    A declared effect explains what it changes less what the alignment would take up without it, to first order; of a
    fitted one, all that it changes may be off. Where rays and the object are is no model, so that what moves them has
    no such error. Beside fitted effects, corrections for finite steps may be uneven.

    Parameters
    ----------
    columns : ndarray, shape (data, numbers)
        From `data_changes`, of the fit.
    accuracy : mapping of str to float
        As `attribute.choose` takes it.
    names : sequence of str
        Of effects, declared or of the fit.

    Returns
    -------
    ndarray, shape (data, distortions)
        One standard deviation of each.
    """
    problem, here = Problem(fitter, fit.effects, fit), fitter.predicted(fit)
    parts, spread = fitter.data.residuals(here), shapes(here.mean)
    after = whitened(parts, fitter.weights)
    found = []
    for name in names:
        share = accuracy.get(name, accuracy["default"])
        if not share or load(name).kinematic or load(name).pattern:
            continue
        other = fitter.of(fitter.model.undeclared(name)) if name in fitter.model.declared else fitter
        physics = {key: values for key, values in fit.physics.items() if key != name}
        there = other.model.predict(physics, fit.nuisance, fitter.data, fit.linearisation)
        change = whitened(fitter.data.residuals(there), fitter.weights) - after
        if name not in fit.effects:
            aligned = columns[:, len(problem.unknowns) :]
            knowledge = Problem(other, fit.effects, fit).knowledge[-len(problem.aligned) :]
            numbers, known = np.vstack([aligned, np.diag(np.sqrt(knowledge))]), np.zeros(len(knowledge))
            change -= aligned @ np.linalg.lstsq(numbers, np.concatenate([change, known]), rcond=None)[0]
        mean, rest = np.split(share * change, [here.mean.size])
        for number, shape in spread.items():  # what else is known of the data changes with the even one
            found.append(np.concatenate([mean * shape.ravel(), rest if number == 0 else np.zeros_like(rest)]))
        if name in fit.effects:
            found += [one for _, one in _of_kernels(fitter, fit, name, parts, share)]
    if set(names) & set(fit.effects):
        found += [one for _, one in _of_steps(fitter, fit, accuracy)]
    return np.stack(found, axis=1) if found else np.zeros((len(after), 0))


def shapes(level: np.ndarray) -> dict[int, np.ndarray]:
    """How a model's error may be spread over the data: evenly, or along an axis or with their level, straight or bent.

    Parameters
    ----------
    level : ndarray
        Along three axes.

    Returns
    -------
    dict of int to ndarray
        By number, the even one 0; shaped as `level`, with a root mean square of 1. An axis of length one has none.
    """
    axes = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in level.shape), indexing="ij", sparse=True)
    rising = [*axes, level, axes[2] ** 2, (level - level.mean()) ** 2]
    found = {0: np.ones(level.shape)}
    for number, one in enumerate(rising, start=1):
        one = np.broadcast_to(one - one.mean(), level.shape)
        spread = one.std()
        if spread > 0:
            found[number] = one / spread
    return found


def harmonics(turned_rad: np.ndarray | None, shape: tuple[int, int, int]) -> dict[str, np.ndarray]:
    """Waves over a turn, by which errors of a grid may vary with the direction it is seen from.

    Parameters
    ----------
    turned_rad : ndarray, shape (views,), or None
        None: there are no views.
    shape : tuple of 3 int
        Of the data.

    Returns
    -------
    dict of str to ndarray
        By name, shaped as the data, with a root mean square of 1.
    """
    if turned_rad is None:
        return {}
    waves = {f"{wave.__name__} {times}": wave(times * turned_rad) for times in HARMONICS for wave in (np.cos, np.sin)}
    sizes = {name: np.sqrt(np.mean(wave**2)) for name, wave in waves.items()}
    return {
        name: np.broadcast_to((wave / sizes[name])[:, None, None], shape)
        for name, wave in waves.items()
        if sizes[name] > 0
    }


@dataclass(frozen=True)
class ModelErrorInfluence:
    """What one recording knows of the numbers, and how distortions of its data pull them.

    Attributes
    ----------
    fit : Fit
        Where it was looked at.
    places : ndarray of int, shape (numbers,)
        Of its numbers among those of all recordings.
    information : ndarray, shape (numbers, numbers)
        By its data.
    knowledge : ndarray, shape (numbers,)
        Information beside the data; of a number that recordings share, their mean counts.
    pulls : dict of (str, int or str) to ndarray, shape (numbers,)
        {(model, shape): J'd}.
    own : list of ndarray, shape (numbers,)
        J'd of those that no other recording has.
    """

    problem: Problem
    fit: Fit
    places: np.ndarray
    information: np.ndarray
    knowledge: np.ndarray
    pulls: dict[tuple[str, int | str], np.ndarray]
    own: list[np.ndarray]

    @classmethod
    def of(
        cls, problem: Problem, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float], places: np.ndarray
    ) -> ModelErrorInfluence:
        """Of a problem that begins where the fit ended."""
        changes = data_changes(problem, fit.pattern)
        fitter = problem.fitter
        pulls = {key: changes.T @ one for key, one in _distortions(fitter, fit, without, accuracy)}
        own = [changes.T @ one for _, one in _of_steps(fitter, fit, accuracy)]
        return cls(problem, fit, places, changes.T @ changes, problem.knowledge, pulls, own)

    @property
    def alone(self) -> ModelErrorInfluence:
        """The same where it is the only recording."""
        return replace(self, places=np.arange(len(self.places)))


def _numbers(scans: Sequence[ModelErrorInfluence]) -> np.ndarray:
    """Standard errors of all numbers of several recordings, shape (numbers,)."""
    count = 1 + max(int(one.places.max()) for one in scans)
    information, knowledge = np.zeros((count, count)), np.zeros(count)
    times = np.bincount(np.concatenate([one.places for one in scans]), minlength=count)
    pulls: dict[tuple[str, int | str], np.ndarray] = {}
    own: list[np.ndarray] = []
    for one in scans:
        information[np.ix_(one.places, one.places)] += one.information
        knowledge[one.places] += one.knowledge / times[one.places]  # what is known of a number is known once
        for key, pull in one.pulls.items():
            pulls.setdefault(key, np.zeros(count))[one.places] += pull
        for pull in one.own:
            own.append(np.zeros(count))
            own[-1][one.places] = pull
    information += np.diag(knowledge)
    root, squares = Known.of(information).root, standard_errors(information) ** 2
    for pull in (*pulls.values(), *own):
        squares = squares + (root @ (root.T @ pull)) ** 2
    return np.sqrt(squares)


def _named(problem: Problem, fit: Fit, numbers: np.ndarray) -> dict[str, dict[str, float]]:
    """Standard errors of a fit's parameters by name; those that are no numbers of the problem keep their own."""
    errors = {name: dict(one) for name, one in fit.errors.items()}
    for one, error in zip(problem.unknowns, numbers, strict=False):
        number = one.of(fit.physics[one.effect][one.name])
        errors[one.effect][one.name] = float(one.value_error(number, error))
    return errors


def _distortions(fitter: Fitter, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float]) -> Distortions:
    """Changes of the whitened data that inexact models may make, one standard deviation each."""
    # One at a time: of a large scan not all of them can be held.
    data, here = fitter.data, fitter.predicted(fit)
    after, spread = data.residuals(here), shapes(here.mean)
    for name, fitted in without.items():
        if load(name).pattern or load(name).kinematic:  # their numbers have no model
            continue
        share, there = accuracy.get(name, accuracy["default"]), fitter.predicted(fitted)
        rest = [share * (one - other) for one, other in zip(data.residuals(there), after, strict=True)][1:]
        change = share * (here.mean - there.mean)
        for number, shape in spread.items():  # what else is known of the data changes with the even one
            yield (name, number), _whole(fitter, change * shape, rest)
            rest = [np.zeros_like(one) for one in rest]
        yield from _of_kernels(fitter, fit, name, after, share)


def _of_kernels(fitter: Fitter, fit: Fit, name: str, after: Sequence[np.ndarray], share: float) -> Distortions:
    """Those that kernels of another form than was assumed may make, of the fit's residuals by part."""
    share = MIXED.get(name, share)
    for parameter in load(name).parameters if share else ():
        if parameter.kernel:
            narrower = {parameter.name: NARROWER * fit.physics[name][parameter.name]}
            physics = fit.physics | {name: fit.physics[name] | narrower}
            there = fitter.model.predict(physics, fit.nuisance, fitter.data, fit.linearisation)
            parts = [one - other for one, other in zip(fitter.data.residuals(there), after, strict=True)]
            yield (name, parameter.name), share * whitened(parts, fitter.weights)


def _of_steps(fitter: Fitter, fit: Fit, accuracy: Mapping[str, float]) -> Distortions:
    """Those that uneven corrections for finite steps may make; of even ones the numbers are fitted."""
    share, data = accuracy.get(NUMERICAL, 0.0), fitter.data
    errors = fitter.model.errors_of_steps(fit.linearisation) if share else {}
    if not errors:
        return
    here = fitter.predicted(fit)
    none = [np.zeros_like(one) for one in data.residuals(here)[1:]]
    spread = {key: shape for key, shape in shapes(here.mean).items() if key != 0}
    spread |= harmonics(fitter.model.turned_rad, here.mean.shape)
    for name, change in errors.items():
        for key, shape in spread.items():
            yield (name, key), _whole(fitter, share * change * shape, none)


def _whole(fitter: Fitter, change: np.ndarray, rest: list[np.ndarray]) -> np.ndarray:
    """A change of the mean and of what else is known of the data, whitened."""
    mean = fitter.data.whitened(np.where(fitter.data.usable, change, 0)).ravel()
    return whitened([mean, *rest], fitter.weights)
