"""A fit, and how good it is."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import stats

from ...physics.effect import load
from ..noise import gain_pattern as patterns
from .fit import Fit, Fitter


@dataclass(frozen=True)
class Trial:
    """A fit, and how good it is.

    Attributes
    ----------
    score : float
        Log score on held-out data.
    p : float
        p-value of its last effect, against the fit without it.
    """

    fit: Fit
    score: float
    p: float


def trial(fitter: Fitter, effects: tuple[str, ...], given: Trial | None = None, against: Trial | None = None) -> Trial:
    """Fit effects and score them.

    A fit that shows an effect begins again from farther off where it stalls. One of what could stand in does not: there
    are many, each of them would take minutes in a large scan, and few come near.

    Parameters
    ----------
    given : Trial, optional
        Where to begin.
    against : Trial, optional
        The fit without the last effect, for its p-value; None: p is 1.
    """
    fit = fitter.fit(effects, None if given is None else given.fit, from_farther=against is not None)
    p = 1.0 if against is None else chance(fit, against.fit, effects[-1])
    return Trial(fit, fitter.score(fit), p)


def chance(fit: Fit, without: Fit, effect: str) -> float:
    """Chance of such a fit if the effect is not there.

    By the likelihood ratio, or, of a gain pattern, by its size.

    Parameters
    ----------
    fit, without : Fit
        With and without the effect.
    """
    if load(effect).pattern:
        return patterns.chance(fit.physics[effect]["rms"], fit.errors[effect]["rms"])
    lost = max(0.0, without.chi_square - fit.chi_square)
    return float(stats.chi2.sf(lost, max(1, fit.free - without.free)))
