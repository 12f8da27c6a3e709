"""What speaks against taking the named effects at their word: bounds that were reached, and noise that does not fit."""

from __future__ import annotations

from collections.abc import Mapping

from ...base.words import label
from .alignment import SURE
from .attribute import Choice
from .model import Model

# Share of a range, or of what the alignment may be off by, within which a number counts as at its bound: steps of fits
# end on the bound itself.
AT_BOUND = 1e-6
# Standard errors that must go into a range for its end to say anything: else the 95 % interval fills it.
WELL_KNOWN = 4.0
# Chi-square per datum of the mean from which the model is no fit: a difference of half the noise's SD in every datum.
MOST_CHI_SQUARE = 1.25


def doubts(choice: Choice, model: Model, held_out: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Phrases for the verdict; none if all is well.

    Parameters
    ----------
    choice : Choice
    model : Model
    held_out : mapping
        Numbers before and after, from verdict.metrics_of.

    Returns
    -------
    list of str
    """
    fit = choice.chosen.fit
    found = []
    plausible = {(name, one.name): one for name in fit.effects for one in model.parameters(name)}
    for one in model.unknowns(fit.effects):
        value, error = fit.physics[one.effect][one.name], fit.errors[one.effect].get(one.name, 0.0)
        low, high = one.value(one.low), one.value(one.high)
        if WELL_KNOWN * error > high - low:  # the data do not tell it: any place of the range would do
            continue
        # The lower end of what begins at 0 is its absence.
        ends = {"upper": high} | ({"lower": low} if low not in (0, one.neutral) else {})
        for end, bound in ends.items():
            if abs(value - bound) <= AT_BOUND * (high - low):
                whole = plausible[one.effect, one.name]
                stated = whole.low < bound < whole.high
                limits = "what its statement allows" if stated else "its range"
                found.append(f"{label(one.name)} of {label(one.effect)} lies at the {end} end of {limits}")
    most = SURE * (1 - AT_BOUND)
    pulled = [one.name for one in model.alignment(fit.effects) if abs(one.off(fit.nuisance[one.name])) > most]
    if pulled:
        names = " and ".join(map(label, pulled))
        found.append(f"{names} of the alignment had to be pulled as far as a fit may ({SURE:g} standard deviations)")
    left = held_out.get("chi_square_mean", {}).get("after", 1.0)
    if left > MOST_CHI_SQUARE:
        found.append(f"chi-square per datum is {left:.2f} where noise alone gives 1.00")
    return found
