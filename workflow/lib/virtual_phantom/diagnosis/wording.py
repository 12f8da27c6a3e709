"""A diagnosis in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..base.words import enumerated, label
from .residuals.residual_tests import ALPHA, KINDS

MATCH, UNEXPLAINED = "match", "unexplained"
PRACTICAL = "match for practical purposes"
# {quantity of images.practice: its unit in words}
UNITS = {
    "hu": "HU",
    "contrast_percent": "% of contrast",
    "noise_percent": "% of noise",
    "resolution_percent": "% of resolution",
    "features_sd": "repeat SDs of a feature",
}
DIGITS = 4  # of a root mean square: repeats of one scan differ in the third


def sentence(content: Mapping) -> str:
    """The verdict in words.

    Parameters
    ----------
    content : mapping
        What diagnosis.json holds, but for the sentence itself.
    """
    recording, verdict = content["recording"], content["verdict"]
    if verdict == MATCH:
        text = f"{recording} and the simulation agree: what they differ by is noise and alignment."
        return text + put_right(content)
    practice = content.get("practice") or {}
    small = practice.get("small", [])
    if verdict == PRACTICAL:
        what = f"what was found beside noise, {listed(content, small)}," if small else "what they differ by"
        return (
            f"{recording} and the simulation agree for practical purposes: {what} changes images by less than matters "
            f"({limits(practice)}).{taken(content)}"
        )
    worst = next((place for place in content["locations"] if place["p"] < ALPHA), content["locations"][0])
    text = f"{recording} and the simulation differ"
    if worst["domain"] == KINDS:
        text += f" by what {worst['where']}"
    else:
        text += f", most in {worst['domain']} ({worst['where']})"
    named = [one["name"] for one in content["effects"] if one["name"] not in small]
    if not named and misstated(content):
        text += "."
    elif not named and "removes" in content.get("object", {}):
        (piece,) = content["object"]["pieces"]
        text += (
            f"{felt(practice)}, and the object may be another than was stated: what differs {piece['what']}. That "
            f"would remove {share(content['object']['removes'], content)} of the difference on data not fitted, "
            "more than effects of the library do."
        )
    elif not named:
        text += f"{felt(practice)}, and no effect of the library explains it."
    elif content["doubts"]:
        text += (
            f"; the best that the library offers is {listed(content, named)}{removed(content, named)}. But "
            f"{enumerated(content['doubts'])}: something else was left out as well, or instead."
        )
    else:
        was = "was" if len(named) == 1 else "were"
        text += f"; left out {was} {listed(content, named)}{removed(content, named)}."
    text += misstated(content) + put_right(content)
    if small:
        text += f" Significant too, but less than matters in images ({limits(practice)}): {listed(content, small)}."
    if named and content["unexplained"]:
        rest = content["unexplained"][0]
        kind, where = rest["domain"], rest["where"]
        text += f" What remains {where}." if kind == KINDS else f" What remains lies most in {kind} ({where})."
    return text + taken(content)


def taken(content: Mapping) -> str:
    """Where the physics is from, if it was not found on this recording."""
    source = next((one["taken_from"] for one in content["effects"] if "taken_from" in one), None)
    if source is None:
        return ""
    left = ", ".join(map(label, content["not_taken"]))
    rest = f" Not taken was the {left} of that scan." if left else ""
    return f" The physics is as found on {source}; only the alignment was fitted here.{rest}"


def put_right(content: Mapping) -> str:
    """What was mended of the object before."""
    found = content.get("object", {})
    if not found.get("mended"):
        return ""
    return f" The object was mended first, where what differed {enumerated([one['what'] for one in found['pieces']])}."


def misstated(content: Mapping, of: str = "") -> str:
    """What was declared and is not so; `of` is said behind each name."""
    found = [
        f"{label(key)} of {label(name)}{of} is {one['value']:.3g} ({one['ci95'][0]:.3g} to {one['ci95'][1]:.3g}) "
        f"{one['unit']}, not {one['stated']:g} ± {one['sd']:g}"
        for name, parameters in content.get("declared", {}).items()
        for key, one in parameters.items()
        if one["off"]
    ]
    return f" Declared otherwise than found: {'; '.join(found)}." if found else ""


def listed(content: Mapping, names: list[str]) -> str:
    """Effects by name, each with those that would do as well in its place, or something that no effect stands for."""

    def rivals(name: str) -> str:
        others = list(map(label, content["ambiguous_with"].get(name, [])))
        if other := content.get("outside", {}).get(name):
            others.append(f"something outside of the library that {other['what']}")
        return label(name) + (f" (or {' or '.join(others)})" if others else "")

    return enumerated(list(map(rivals, names)))


def removed(content: Mapping, names: Sequence[str]) -> str:
    """What effects of these names remove, with the root mean square that it is a share of."""
    if content["excess_removed"] is None:
        return ""
    verb = "which removes" if len(names) == 1 else "which together remove"
    text = f", {verb} {share(content['excess_removed'], content)} of the difference on data not fitted"
    root = next((entry for name, entry in content["held_out"].items() if name.startswith("rms_")), None)
    if root is None:
        return text
    before, after, floor = (f"{root[key]:.{DIGITS}g}" for key in ("before", "after", "floor"))
    of_root = content.get("excess_rms_removed")
    # A model that fits no better has no share of a root to boast of: the roots alone say so.
    begin = f"{share(of_root, content)} of its root mean square:" if of_root and of_root > 0 else "root mean square"
    return f"{text} ({begin} {before}, then {after}; noise alone {floor})"


def share(part: float, content: Mapping) -> str:
    """A share of a difference in percent: not 100 where something is left or in doubt."""
    text = f"{100 * part:.1f}"
    left = part < 1 or content.get("unexplained") or content.get("doubts")
    return "over 99.9 %" if text == "100.0" and left else f"{text} %"


def limits(practice: Mapping) -> str:
    """The thresholds of what matters, with what each was found to be of all effects together."""
    return ", ".join(f"{value:g} {UNITS[name]}" for name, value in practice["thresholds"].items())


def felt(practice: Mapping) -> str:
    """Where images differ by more than matters, in words."""
    found = practice.get("differing", {})
    if not found:
        return ""
    return ", in images by " + ", ".join(f"{value:.3g} {UNITS[name]}" for name, value in found.items())
