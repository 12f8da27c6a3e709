"""A score as the table of docs/validation/blind-validation.md."""

from __future__ import annotations

from collections.abc import Mapping

from ...base.names import label
from ...report.agreement_table import NAMES
from ...report.html import number
from ...report.proof import percent, reached, tally, valued

LEFT = "left of it, standard deviations of noise: median, ninetieth percentile, most"


def rows(score: Mapping) -> list[str]:
    """Lines of a table in Markdown: what was found, what was asked for, whether it was reached."""
    lines = ["| | found | asked | |", "|---|---|---|---|"]
    targets = {target["name"]: target for target in score["targets"]}
    accuracy, removed, agreement = score["accuracy"], score["excess_removed"], score["agreement"]

    def line(what: str, found: str, target: str | None = None) -> None:
        asked, word = "", ""
        if target is not None:
            one = targets[target]
            asked, word = f"{one['sense']} {valued(one['target'], one)}", reached(one)[1]
            word = f"**{word}**" if word == "missed" else word
        lines.append(f"| {what} | {found} | {asked} | {word} |".replace("\N{NO-BREAK SPACE}", " "))

    first, stand_in = accuracy["first"], accuracy["first_or_stand_in"]
    line("named first, one effect of medium or strong strength", tally(first["medium_or_strong"]), "first")
    line("the same, or reported as its equal", tally(stand_in["medium_or_strong"]))
    line("named first, one weak effect", tally(first["by_strength"]["weak"]))
    line("the same, or reported as its equal", tally(stand_in["by_strength"]["weak"]))
    for model, share in first["by_model"].items():
        line(f"named first, effects made by {model}", tally(share))
    line("both of two effects named", tally(accuracy["pairs"]["both_named"]), "pairs")
    line("false alarms where nothing is concealed", tally(accuracy["false_alarms"]), "false_alarms")
    line("owned up to, where the library lacks the effect", tally(accuracy["unknown"]), "unknown")
    for name, one in score["remainders"]["by_kind"].items():
        line(f"the same, {name.replace('_', ' ')}", tally(one))
    if (area := score["remainders"]["area"]) is not None:
        line("area under the curve of remainders, lacking against had", f"{area:.2f}")
    line("precisely what was concealed, and nothing else", tally(accuracy["exact"]["all"]))
    for key, what in (
        ("in_library", "one or two effects of the library"),
        ("right", "precisely what was concealed"),
        ("wrong", "something named that was not concealed"),
        ("lacking", "an effect that the library lacks"),
    ):
        one = removed[key]
        found = f"{percent(one['median'])}, {percent(one['tenth_percentile'])} of {one['n']} cases"
        asked = "excess_removed" if key == "in_library" else None
        line(f"held-out excess removed, median and tenth percentile: {what}", found, asked)
        left = [one["remainder_sd"][part] for part in ("median", "ninetieth_percentile", "most")]
        line(LEFT, ", ".join("–" if value is None else number(value) for value in left))
    for metric, one in agreement["metrics"].items():
        for name, values in (("", one), *((f", {name}", own[metric]) for name, own in agreement["by_phantom"].items())):
            rest = f"noise alone {percent(values['floor'])}, before the fit {percent(values['before'])}"
            found = f"{percent(values['after'])} ({rest}; {values['n']} cases)"
            line(
                f"by another protocol, {NAMES[metric]}{name}", found, metric if metric in targets and not name else None
            )
    parameters = score["parameters"]
    line("error of parameters, median", percent(parameters["all"]["median_absolute_relative_error"]))
    line("95 % intervals that hold the truth", tally(parameters["all"]["covered"]))
    for model, one in parameters["by_model"].items():
        line(f"the same, effects made by {model}", tally(one["covered"]))
    for name, one in parameters["by_effect"].items():
        line(f"the same, {label(name)}", tally(one["covered"]))
    for key in ("first_named", "gain", "ruled_out"):
        for one in score["calibration"][key]:
            line(f"came true of {label(key)}: {one['stated']}", tally(one["came_true"]))
    return lines
