"""By how much a fit's numbers may be off because its models are inexact, beside what noise does.

A wrong model shifts numbers that seem well known [1]_. Here a model of an effect may be wrong by a share of what it
explains (`model_accuracy`): as a whole, or rising along an axis of the data or with the attenuation. So may the
corrections for finite steps be. The same shares guard the choice of effects.

References
----------
.. [1] J. Brynjarsdottir and A. O'Hagan, Inverse Problems 30, 114007, 2014.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...physics.effect import load
from .fit import Fit, Fitter, Problem
from .steps import Known, standard_errors
from .templates import data_changes, whitened, with_knowledge


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
    fitter : Fitter
    fit : Fit
    without : mapping of str to Fit
        {effect: the fit without it}, of those whose models may be inexact: what an effect explains is by how much these
        differ.
    accuracy : mapping of str to float
        As `attribute.choose` takes it.

    Returns
    -------
    Errors
    """
    errors = Errors({name: dict(one) for name, one in fit.errors.items()}, dict(fit.nuisance_errors))
    distortions = _distortions(fitter, fit, without, accuracy)
    if not distortions:
        return errors
    problem = Problem(fitter, fit.effects, fit)
    columns = with_knowledge(data_changes(problem, fit.pattern), problem)
    information = columns.T @ columns
    root = Known.of(information).root
    squares = standard_errors(information) ** 2
    for one in distortions:
        squares = squares + (root @ (root.T @ (columns[: len(one)].T @ one))) ** 2
    numbers = np.sqrt(squares)
    for one, number, error in zip(problem.unknowns, problem.start, numbers, strict=False):
        errors.physics[one.effect][one.name] = float(one.value_error(number, error))
    names = [one.name for one in problem.aligned]
    errors.nuisance.update(zip(names, map(float, numbers[len(problem.unknowns) :]), strict=True))
    return errors


def shapes(level: np.ndarray) -> list[np.ndarray]:
    """How a model's error may be spread over the data: evenly, or along an axis or with their level, straight or bent.

    Parameters
    ----------
    level : ndarray
        Along three axes.

    Returns
    -------
    list of ndarray
        Shaped as `level`; each has a root mean square of 1.
    """
    axes = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in level.shape), indexing="ij", sparse=True)
    rising = [*axes, level, axes[2] ** 2, (level - level.mean()) ** 2]
    found = [np.ones(level.shape)]
    for one in rising:
        one = np.broadcast_to(one - one.mean(), level.shape)
        spread = one.std()
        if spread > 0:
            found.append(one / spread)
    return found


def _distortions(
    fitter: Fitter, fit: Fit, without: Mapping[str, Fit], accuracy: Mapping[str, float]
) -> list[np.ndarray]:
    """Changes of the whitened data that inexact models may make, one standard deviation each, shape (data,)."""
    data, here = fitter.data, fitter.predicted(fit)
    after, spread, found = data.residuals(here), shapes(here.mean), []

    def add(change: np.ndarray, rest: list[np.ndarray]) -> None:
        """A change of the mean, spread out; what else is known of the data changes with the even one."""
        for shape in spread:
            mean = data.whitened(np.where(data.usable, change * shape, 0)).ravel()
            found.append(whitened([mean, *rest], fitter.weights))
            rest = [np.zeros_like(one) for one in rest]

    for name, fitted in without.items():
        if load(name).pattern:  # no number has a model then
            continue
        share, there = accuracy.get(name, accuracy["default"]), fitter.predicted(fitted)
        rest = [share * (one - other) for one, other in zip(data.residuals(there), after, strict=True)][1:]
        add(share * (here.mean - there.mean), rest)
    corrected = accuracy.get("numerical", 0.0) * np.asarray(fitter.model.distortion(fit.nuisance, fit.linearisation))
    if corrected.any():
        add(corrected, [np.zeros_like(one) for one in after[1:]])
    return found
