"""A fit with its held-out log score and p-value."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import stats

from ...physics.effect import load
from ..noise import gain_pattern
from .fit import Fit, Fitter


@dataclass(frozen=True)
class Trial:
    """A fit, its log score on held-out data, and the p-value of its last effect against the fit without it."""

    fit: Fit
    score: float
    p: float


def trial(fitter: Fitter, effects: tuple[str, ...], given: Trial | None = None, against: Trial | None = None) -> Trial:
    """Fit and score effects.

    Parameters
    ----------
    against : Trial, optional
        Fit without the last effect, for its p-value; None: p is 1. Only with it does a fit that stalls start again from
        farther off: alternatives are many, each would take minutes in a large scan, and few come near.
    """
    fit = fitter.fit(effects, None if given is None else given.fit, from_farther=against is not None)
    p = 1.0 if against is None else chance(fit, against.fit, effects[-1])
    return Trial(fit, fitter.score(fit), p)


def chance(fit: Fit, without: Fit, effect: str) -> float:
    """Return an effect's p-value by the likelihood ratio of fits with and without it, or by a gain pattern's size."""
    if load(effect).pattern:
        return gain_pattern.chance(fit.physics[effect]["rms"], fit.errors[effect]["rms"])
    lost = max(0.0, without.chi_square - fit.chi_square)
    return float(stats.chi2.sf(lost, max(1, fit.free - without.free)))
