"""Whether what a diagnosis found matters to users of images: the verdict by thresholds that they set."""

from __future__ import annotations

from collections.abc import Mapping

from ..wording import MATCH, PRACTICAL, UNEXPLAINED, UNITS, misstated, sentence


def in_practice(content: Mapping, thresholds: Mapping[str, float]) -> dict:
    """Judge a diagnosis by what it means in images.

    An effect is named as left out only if images change by more than a threshold without it. Where nothing that was
    found does, and recording and simulation differ by less too, they match for practical purposes. Of a recording
    without images nothing is judged.

    Parameters
    ----------
    content : mapping
        What diagnosis.json holds, its agreement with `practice` (images.practice.told).
    thresholds : mapping of str to float
        {quantity of core.sentence.UNITS: the least that matters}; 0: every effect that is found does.

    Returns
    -------
    dict
        The content with verdict, sentence and `practice`: thresholds, `recorded`, `effects` and `together` as told,
        `small` (effects found that do not matter) and `differing` ({quantity: by how much recording and simulation
        differ where it matters}).
    """
    content = dict(content)
    agreement = dict(content.get("agreement") or {})
    told = agreement.pop("practice", None)
    content["agreement"] = agreement
    if told is None:
        return content
    names = [one["name"] for one in content["effects"]]
    small = [name for name in names if not over(told["effects"][name], thresholds)]
    if small == names and over(told["together"], thresholds):
        small = []  # each for itself could be missed, all of them not
    differing = over(told["recorded"], thresholds)
    content["practice"] = {"thresholds": dict(thresholds), **told, "small": small, "differing": differing}
    # A statement that does not hold is a finding of its own, though with it images agree.
    if content["verdict"] != MATCH and small == names and not misstated(content):
        content["verdict"] = UNEXPLAINED if differing else PRACTICAL
    return content | {"sentence": sentence(content)}


def over(changes: Mapping[str, Mapping[str, float]], thresholds: Mapping[str, float]) -> dict[str, float]:
    """Quantities that change by more than their threshold for sure, two standard errors taken off, with their values.

    Parameters
    ----------
    changes : mapping of str to mapping
        {quantity: {"value", "error"}}.
    """
    return {
        name: changes[name]["value"]
        for name in UNITS
        if name in changes and abs(changes[name]["value"]) - 2 * changes[name]["error"] > thresholds[name]
    }
