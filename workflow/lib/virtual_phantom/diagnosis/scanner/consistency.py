"""What each recording of a scanner says alone, and which of them disagree with the others.

Numbers that recordings share are fitted to each alone. One disagrees if its numbers differ from the others' by more
than noise and inexact models make up [1]_. A model that is inexact alike in all recordings sets none apart. Where a
recording's own fit leaves more than noise, its errors are wider by the root of chi-square per ray [2]_. The one that
disagrees most is set aside, and the rest are asked again.

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
from ..fitting.steps import Known
from ..residuals.residual_tests import ALPHA
from ..uncertainty.model_error import ModelErrorInfluence, errors_of_pulled

LEAST_KNOWN = 1e-9  # of what one recording knows of a direction, that the others must know: less is rounding


@dataclass(frozen=True)
class Difference:
    """By how much one recording's numbers differ from those of others.

    Attributes
    ----------
    against : tuple of str
        The others.
    chi_square : float
        Over what noise and inexact models make up.
    numbers : int
        How many numbers both know.
    p : float
        Chance of such a difference, over all recordings that are compared.
    """

    against: tuple[str, ...]
    chi_square: float
    numbers: int
    p: float

    @property
    def surprise(self) -> float:
        """Minus the logarithm of the chance of one such difference, also where that is too small for a number."""
        return -float(stats.chi2.logsf(self.chi_square, self.numbers)) if self.numbers else 0.0

    @property
    def disagrees(self) -> bool:
        """Whether that is no chance."""
        return self.p < ALPHA


@dataclass(frozen=True)
class Alone:
    """One recording by itself, beside those that it is compared with.

    Attributes
    ----------
    fit : Fit
        Of all effects to this recording alone.
    errors : dict of str to dict of str to float
        Of its parameters, inexact models counted, as Fit.errors; by the slopes where all are fitted together.
    """

    fit: Fit
    errors: dict[str, dict[str, float]]
    difference: Difference


@dataclass(frozen=True)
class _Shared:
    """What one recording alone knows of the numbers that recordings share.

    Its alignment, and what only it has, are fitted beside them.

    Attributes
    ----------
    score : ndarray, shape (shared,)
        Information times its numbers, as its data alone have them: what is known beside data is known once, of all.
    information : ndarray, shape (shared, shared)
        Of its data, and of what is known of its alignment.
    pulls : dict of (str, int or str) to ndarray, shape (shared,)
        As Pulled.pulls.
    own : list of ndarray, shape (shared,)
        As Pulled.own.
    excess : float
        Chi-square per ray of its own fit, 1 at least, by which information and pulls are divided.
    """

    score: np.ndarray
    information: np.ndarray
    pulls: dict[tuple[str, int | str], np.ndarray]
    own: list[np.ndarray]
    excess: float


def alone(
    together: JointFitter, chosen: JointFit, scans: Mapping[str, ModelErrorInfluence], judged: Collection[str] = ()
) -> dict[str, Alone]:
    """Fit each recording alone, and compare it with the others.

    Parameters
    ----------
    together : JointFitter
        Of all recordings.
    chosen : JointFit
        Of those that are not judged.
    scans : mapping of str to ModelErrorInfluence
        Of all recordings, from pulled_of_recordings.
    judged : collection of str, optional
        Recordings that no other one is compared with.

    Returns
    -------
    dict of str to Alone
        By recording; empty where they share no number.
    """
    shared = np.flatnonzero(np.bincount(np.concatenate([one.places for one in scans.values()])) > 1)
    if not len(shared):
        return {}
    fits = {name: together.fitters[name].fit(one.fit.effects, one.fit) for name, one in scans.items()}
    compared = _Compared(together, chosen, scans, fits, shared).sifted([name for name in scans if name not in judged])
    errors = {name: errors_of_pulled({name: one.alone}, fits)[name] for name, one in scans.items()}
    return {name: Alone(fit, errors[name], compared[name]) for name, fit in fits.items()}


class _Compared:
    """Comparisons of recordings with others, by slopes first; only what these find is fitted together."""

    def __init__(
        self,
        together: JointFitter,
        chosen: JointFit,
        scans: Mapping[str, ModelErrorInfluence],
        fits: Mapping[str, Fit],
        shared: np.ndarray,
    ):
        self.together, self.fits = together, fits
        self.given = replace(chosen, fits={name: one.fit for name, one in scans.items()})
        self.known = {name: _shared(one, fits[name], shared) for name, one in scans.items()}
        self._totals: dict[frozenset[str], float] = {}

    def sifted(self, rest: list[str]) -> dict[str, Difference]:
        """Of every recording, its difference from those of `rest` that agree with each other."""
        while True:
            now = {name: self.compared(name, rest) for name in rest}
            worst = max(rest, key=lambda name: now[name].surprise)
            if not now[worst].disagrees or len(rest) < 3:
                break
            rest = [name for name in rest if name != worst]
        return now | {name: self.compared(name, rest) for name in self.known if name not in now}

    def compared(self, name: str, rest: Sequence[str]) -> Difference:
        """By slopes; where these say that a difference is no chance, by fits."""
        found, share = self.by_slopes(name, rest)
        if not found.disagrees:
            return found
        lost = self._total([name, *found.against]) - self._total(found.against) - self._total([name])
        return self._difference(found.against, min(found.chi_square, share * lost), found.numbers)

    def by_slopes(self, name: str, rest: Sequence[str]) -> tuple[Difference, float]:
        """A recording's numbers less those of others, over what their errors and inexact models make up.

        Returns
        -------
        share : float
            Of chi-square without excess, what is left of it with it.
        """
        one, others = self.known[name], [other for other in rest if other != name]
        known = [self.known[other] for other in others]
        information = sum(other.information for other in known)
        inverse, inverses = (Known.of(each).covariance for each in (one.information, information))
        none = np.zeros(len(one.score))
        difference = inverse @ one.score - inverses @ sum(other.score for other in known)
        weight, numbers = _both_know(one.information, information)
        apart = weight @ difference
        square = float(difference @ apart)
        plain = _both_know(one.excess * one.information, sum(other.excess * other.information for other in known))[0]
        whole = float(difference @ plain @ difference)
        share = square / whole if whole > 0 else 1.0
        shifts = [
            inverse @ one.pulls.get(key, none) - inverses @ sum(other.pulls.get(key, none) for other in known)
            for key in dict.fromkeys(key for each in (one, *known) for key in each.pulls)
        ]
        shifts += [inverse @ pull for pull in one.own]
        shifts += [inverses @ pull for other in known for pull in other.own]
        if shifts:
            columns = np.stack(shifts, axis=1)
            seen = columns.T @ apart
            square -= float(seen @ np.linalg.solve(np.eye(len(seen)) + columns.T @ weight @ columns, seen))
        return self._difference(others, square, numbers), share

    def _difference(self, others: Sequence[str], square: float, numbers: int) -> Difference:
        square = max(0.0, square)
        p = float(bonferroni(stats.chi2.sf(square, numbers), len(self.known))) if numbers else 1.0
        return Difference(tuple(others), square, numbers, p)

    def _total(self, names: Collection[str]) -> float:
        """Chi-square of some recordings, fitted together, without what is known of effects beside data."""
        key = frozenset(names)
        if key not in self._totals:
            if len(key) == 1:
                fits = {name: self.fits[name] for name in key}
            else:
                others = self.together.without([name for name in self.together.fitters if name not in key])
                fits = others.fit(self.given.effects, self.given).fits
            self._totals[key] = sum(
                sum(fit.parts) + sum(pull**2 for pull in fit.pulled.values()) for fit in fits.values()
            )
        return self._totals[key]


def _both_know(one: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, int]:
    """Inverse covariance of a difference, and of how many numbers: A - A (A + B)^-1 A, in units of A.

    Parameters
    ----------
    one, others : ndarray, shape (shared, shared)
        A and B.

    Returns
    -------
    weight : ndarray, shape (shared, shared)
    """
    root = Known.of(one).root
    values, vectors = np.linalg.eigh(
        np.eye(root.shape[1]) - root.T @ one @ Known.of(one + others).covariance @ one @ root
    )
    seen = values > LEAST_KNOWN
    directions = one @ root @ vectors[:, seen]
    return (directions * values[seen]) @ directions.T, int(seen.sum())


def _shared(scan: ModelErrorInfluence, fit: Fit, shared: np.ndarray) -> _Shared:
    """What a recording's own fit says of shared numbers, all else of it fitted."""
    size, excess = len(shared), max(1.0, fit.chi_square / scan.problem.count)
    inside = np.isin(scan.places, shared)
    whole = scan.information + np.diag(np.where(inside, 0.0, scan.knowledge))
    here, own = np.flatnonzero(inside), np.flatnonzero(~inside)
    there = np.searchsorted(shared, scan.places[here])
    taken = whole[np.ix_(here, own)] @ Known.of(whole[np.ix_(own, own)]).covariance

    def marginal(pull: np.ndarray) -> np.ndarray:
        found = np.zeros(size)
        found[there] = (pull[here] - taken @ pull[own]) / excess
        return found

    information, score = np.zeros((size, size)), np.zeros(size)
    information[np.ix_(there, there)] = (whole[np.ix_(here, here)] - taken @ whole[np.ix_(own, here)]) / excess
    values = np.zeros(size)
    for index, place in zip(here, there, strict=True):
        one = scan.problem.unknowns[index]
        values[place] = one.of(fit.physics[one.effect][one.name])
        # Where the fit ends, data pull as much as what is known beside them pulls back.
        score[place] = scan.knowledge[index] * (values[place] - scan.problem.centre[index]) / excess
    score += information @ values
    pulls = {key: marginal(pull) for key, pull in scan.pulls.items()}
    return _Shared(score, information, pulls, [marginal(pull) for pull in scan.own], excess)
