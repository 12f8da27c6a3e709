"""Consistency of the recordings of a scanner: fits of each recording alone, compared with the others.

Shared parameters are fitted to each recording alone. A recording disagrees if its parameters differ from the
others by more than noise and model errors explain [1]_. A model error that all recordings share causes no disagreement.
If the fit of a recording leaves more than noise, its errors are scaled by the root of chi-square per ray [2]_. The
recording that disagrees most is removed, and the rest are compared again.

References
----------
.. [1] M. Maltoni and T. Schwetz, Phys. Rev. D 68, 033020, 2003.
.. [2] R. T. Birge, Phys. Rev. 40, 207, 1932.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.joint_fit import JointFit, JointFitter
from ..fitting.steps import ScaledEigenvalues
from ..residuals.residual_tests import ALPHA
from ..uncertainty.model_error import ModelErrorInfluence, joint_errors_with_models

LEAST_KNOWN = 1e-9  # information of the others about a direction, relative to one recording; less is rounding


@dataclass(frozen=True)
class Difference:
    """Difference between the parameters of one recording and of others.

    Attributes
    ----------
    chi_square : float
        Chi-square of the difference, with noise and model errors.
    numbers : int
        Number of parameters that this recording and the others determine.
    p : float
        p-value, corrected for the number of compared recordings.
    """

    against: tuple[str, ...]
    chi_square: float
    numbers: int
    p: float

    @property
    def surprise(self) -> float:
        """Minus the logarithm of the uncorrected p-value, also for p-values below the range of floats."""
        return -float(stats.chi2.logsf(self.chi_square, self.numbers)) if self.numbers else 0.0

    @property
    def disagrees(self) -> bool:
        """Whether the difference is significant."""
        return self.p < ALPHA


@dataclass(frozen=True)
class Alone:
    """Fit of one recording alone, and its difference from the others.

    Attributes
    ----------
    fit : Fit
        All effects, fitted to this recording alone.
    errors : dict of str to dict of str to float
        Standard errors with model errors, from derivatives at the joint fit.
    """

    fit: Fit
    errors: dict[str, dict[str, float]]
    difference: Difference


@dataclass(frozen=True)
class _Shared:
    """Information of one recording about shared parameters, with its other parameters profiled out.

    Attributes
    ----------
    score : ndarray, shape (shared,)
        Information times parameters, from the data alone, because priors are counted once for all recordings.
    information : ndarray, shape (shared, shared)
        Information of the data and of the priors of the alignment.
    gradients : dict of (str, int or str) to ndarray, shape (shared,)
        See ModelErrorInfluence.gradients.
    own_gradients : list of ndarray, shape (shared,)
        See ModelErrorInfluence.own_gradients.
    excess : float
        Chi-square per ray of the recording's own fit, at least 1. Information and gradients are divided by it.
    """

    score: np.ndarray
    information: np.ndarray
    gradients: dict[tuple[str, int | str], np.ndarray]
    own_gradients: list[np.ndarray]
    excess: float


def alone(
    together: JointFitter, chosen: JointFit, scans: Mapping[str, ModelErrorInfluence], judged: Collection[str] = ()
) -> dict[str, Alone]:
    """Fit each recording alone, and compare it with the others; empty if they share no parameter.

    Parameters
    ----------
    chosen : JointFit
        Fit of the recordings that are not judged.
    scans : mapping of str to ModelErrorInfluence
        Result of model_error.influences_of_recordings for all recordings.
    judged : collection of str, optional
        Test recordings; the other recordings are not compared with them.
    """
    shared = np.flatnonzero(np.bincount(np.concatenate([influence.places for influence in scans.values()])) > 1)
    if not len(shared):
        return {}
    fits = {name: together.fitters[name].fit(influence.fit.effects, influence.fit) for name, influence in scans.items()}
    compared = _Compared(together, chosen, scans, fits, shared).sifted([name for name in scans if name not in judged])
    errors = {name: joint_errors_with_models({name: influence.alone}, fits)[name] for name, influence in scans.items()}
    return {name: Alone(fit, errors[name], compared[name]) for name, fit in fits.items()}


class _Compared:
    """Comparisons of recordings with others, to first order; significant differences are then refitted jointly."""

    def __init__(
        self,
        together: JointFitter,
        chosen: JointFit,
        scans: Mapping[str, ModelErrorInfluence],
        fits: Mapping[str, Fit],
        shared: np.ndarray,
    ):
        self.together, self.fits = together, fits
        self.given = replace(chosen, fits={name: influence.fit for name, influence in scans.items()})
        self.known = {name: _shared(influence, fits[name], shared) for name, influence in scans.items()}
        self._totals: dict[frozenset[str], float] = {}

    def sifted(self, rest: list[str]) -> dict[str, Difference]:
        """Return the difference of each recording from the consistent ones of `rest`."""
        while True:
            now = {name: self.compared(name, rest) for name in rest}
            worst = max(rest, key=lambda name: now[name].surprise)
            if not now[worst].disagrees or len(rest) < 3:
                break
            rest = [name for name in rest if name != worst]
        return now | {name: self.compared(name, rest) for name in self.known if name not in now}

    def compared(self, name: str, rest: Sequence[str]) -> Difference:
        """Return the first-order difference; if it is significant, return the smaller one of it and of joint fits."""
        found, share = self.by_slopes(name, rest)
        if not found.disagrees:
            return found
        lost = self._total([name, *found.against]) - self._total(found.against) - self._total([name])
        return self._difference(found.against, min(found.chi_square, share * lost), found.numbers)

    def by_slopes(self, name: str, rest: Sequence[str]) -> tuple[Difference, float]:
        """Return the first-order difference of a recording's parameters from the parameters of others.

        Returns
        -------
        share : float
            Ratio of the chi-square with and without scaling by the excess.
        """
        this, others = self.known[name], [other for other in rest if other != name]
        known = [self.known[other] for other in others]
        information = sum(other.information for other in known)
        inverse, inverses = (ScaledEigenvalues.of(each).covariance for each in (this.information, information))
        none = np.zeros(len(this.score))
        difference = inverse @ this.score - inverses @ sum(other.score for other in known)
        weight, numbers = _difference_information(this.information, information)
        weighted = weight @ difference
        square = float(difference @ weighted)
        plain = _difference_information(
            this.excess * this.information, sum(other.excess * other.information for other in known)
        )[0]
        whole = float(difference @ plain @ difference)
        share = square / whole if whole > 0 else 1.0
        shifts = [
            inverse @ this.gradients.get(key, none) - inverses @ sum(other.gradients.get(key, none) for other in known)
            for key in dict.fromkeys(key for recording in (this, *known) for key in recording.gradients)
        ]
        shifts += [inverse @ gradient for gradient in this.own_gradients]
        shifts += [inverses @ gradient for other in known for gradient in other.own_gradients]
        if shifts:
            columns = np.stack(shifts, axis=1)
            seen = columns.T @ weighted
            square -= float(seen @ np.linalg.solve(np.eye(len(seen)) + columns.T @ weight @ columns, seen))
        return self._difference(others, square, numbers), share

    def _difference(self, others: Sequence[str], square: float, numbers: int) -> Difference:
        square = max(0.0, square)
        p = float(bonferroni(stats.chi2.sf(square, numbers), len(self.known))) if numbers else 1.0
        return Difference(tuple(others), square, numbers, p)

    def _total(self, names: Collection[str]) -> float:
        """Return the chi-square of the joint fit of some recordings, without priors of effects."""
        key = frozenset(names)
        if key not in self._totals:
            if len(key) == 1:
                fits = {name: self.fits[name] for name in key}
            else:
                others = self.together.without([name for name in self.together.fitters if name not in key])
                fits = others.fit(self.given.effects, self.given).fits
            self._totals[key] = sum(
                sum(fit.parts) + sum(pull**2 for pull in fit.pulls.values()) for fit in fits.values()
            )
        return self._totals[key]


def _difference_information(first: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the inverse covariance of a difference, A - A (A + B)^-1 A, and its rank.

    Parameters
    ----------
    first, others : ndarray, shape (shared, shared)
        A and B.

    Returns
    -------
    weight : ndarray, shape (shared, shared)
    """
    root = ScaledEigenvalues.of(first).root
    values, vectors = np.linalg.eigh(
        np.eye(root.shape[1]) - root.T @ first @ ScaledEigenvalues.of(first + others).covariance @ first @ root
    )
    seen = values > LEAST_KNOWN
    directions = first @ root @ vectors[:, seen]
    return (directions * values[seen]) @ directions.T, int(seen.sum())


def _shared(scan: ModelErrorInfluence, fit: Fit, shared: np.ndarray) -> _Shared:
    """Return the information of a recording's own fit about shared parameters, all others profiled out."""
    size, excess = len(shared), max(1.0, fit.chi_square / scan.problem.count)
    inside = np.isin(scan.places, shared)
    whole = scan.information + np.diag(np.where(inside, 0.0, scan.problem.prior_precision))
    here, own = np.flatnonzero(inside), np.flatnonzero(~inside)
    there = np.searchsorted(shared, scan.places[here])
    taken = whole[np.ix_(here, own)] @ ScaledEigenvalues.of(whole[np.ix_(own, own)]).covariance

    def marginal(gradient: np.ndarray) -> np.ndarray:
        found = np.zeros(size)
        found[there] = (gradient[here] - taken @ gradient[own]) / excess
        return found

    information, score = np.zeros((size, size)), np.zeros(size)
    information[np.ix_(there, there)] = (whole[np.ix_(here, here)] - taken @ whole[np.ix_(own, here)]) / excess
    values = np.zeros(size)
    for index, place in zip(here, there, strict=True):
        unknown = scan.problem.unknowns[index]
        values[place] = unknown.of(fit.physics[unknown.effect][unknown.name])
        # At the minimum, the gradients of data and prior balance.
        gradient = scan.problem.prior_precision[index] * (values[place] - scan.problem.center[index])
        score[place] = gradient / excess
    score += information @ values
    gradients = {key: marginal(gradient) for key, gradient in scan.gradients.items()}
    return _Shared(score, information, gradients, list(map(marginal, scan.own_gradients)), excess)
