"""A fit with its log score and p-value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from ...physics.effect import load
from .fit import Fit, Fitter
from .joint_fit import JointFit


@dataclass(frozen=True)
class Trial:
    """A fit, its log score (Fitter.score), and the p-value of its last effect against the fit without it."""

    fit: Fit
    score: float
    p: float


def trial(
    fitter: Fitter,
    effects: tuple[str, ...],
    given: Trial | None = None,
    against: Trial | None = None,
    needed: float = np.inf,
    final: bool = True,
) -> Trial:
    """Fit and score effects.

    Parameters
    ----------
    against : Trial, optional
        Fit without the last effect, for its p-value; None: p is 1, and a fit that stalls is not repeated from starts
        farther away. There are many alternatives, and each repetition takes minutes in a large scan.
    needed, final
        As for Fitter.fit.
    """
    start = None if given is None else given.fit
    fit = fitter.fit(effects, start, from_farther=against is not None, final=final, needed=needed)
    p = 1.0 if against is None else effect_p_value(fitter.comparable(fit, against.fit), against.fit, effects[-1])
    return Trial(fit, fitter.score(fit), p)


def effect_p_value(fit: Fit | JointFit, without: Fit | JointFit, effect: str) -> float:
    """Return an effect's p-value from the likelihood ratio of fits with and without it (see Fitter.comparable).

    For a gain pattern, it is Pattern.p.
    """
    if load(effect).pattern:
        return fit.pattern.p
    lost = max(0.0, without.deviance - fit.deviance)
    return float(stats.chi2.sf(lost, max(1, fit.free - without.free)))
