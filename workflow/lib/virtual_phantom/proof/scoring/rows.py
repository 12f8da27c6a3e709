"""A score as a Markdown table."""

from __future__ import annotations

from collections.abc import Mapping

from ...base.names import label
from ...report.agreement_table import NAMES
from ...report.html import number
from ...report.proof import percent, reached, tally, valued
from ...statistics.proof_record import QUANTITIES
from ..hiding.hidden_effect import EQUATIONS

LEFT = "unexplained, standard deviations of noise: median, 90th percentile, maximum"


def rows(score: Mapping) -> list[str]:
    """Return the lines of a table of all results: quantity, result, target, and whether the target is reached."""
    lines = ["| | result | target | |", "|---|---|---|---|"]
    targets = {target["name"]: target for target in score["targets"]}
    counted, accuracy = score["headline"], score["accuracy"]
    removed, agreement = score["excess_removed"], score["agreement"]

    def line(quantity: str, found: str, target: str | None = None) -> None:
        limit, word = "", ""
        if target is not None:
            entry = targets[target]
            limit, word = f"{entry['sense']} {valued(entry['target'], entry)}", reached(entry)[1]
            word = f"**{word}**" if word == "missed" else word
        lines.append(f"| {quantity} | {found} | {limit} | {word} |".replace("\N{NO-BREAK SPACE}", " "))

    for name, quantity in QUANTITIES.items():
        line(quantity, tally(counted["all"][name]), name if name in targets else None)
        line("the same, by significance", tally(counted["by_significance"][name]))
        line("the same, the library's own equations", tally(counted["own"][name]))
        if worst := counted["worst"].get(name):
            line(f"the worst class ({worst['kind']}): {label(worst['class'])}", tally(worst))
    for source, share in accuracy["first"]["by_equation"].items():
        line(f"one effect: ranked first, effects made by {EQUATIONS[source]}", tally(share))
    for name, entry in score["remainders"]["by_kind"].items():
        line(f"reported as unexplained: {label(name)}", tally(entry))
    if (area := score["remainders"]["area"]) is not None:
        line("area under the curve of unexplained differences, missing and available effects", f"{area:.2f}")
    for key, group in (
        ("in_library", "one or two effects of the library"),
        ("right", "precisely the hidden effects named"),
        ("wrong", "an effect named that is not hidden"),
        ("lacking", "an effect that the library lacks"),
    ):
        entry = removed[key]
        found = f"{percent(entry['median'])}, {percent(entry['tenth_percentile'])} of {entry['n']} cases"
        target = "excess_removed" if key == "in_library" else None
        line(f"held-out excess RMS removed, median and tenth percentile: {group}", found, target)
        remainders = [entry["remainder_sd"][part] for part in ("median", "ninetieth_percentile", "most")]
        line(LEFT, ", ".join("–" if value is None else number(value) for value in remainders))
    for metric, entry in agreement["metrics"].items():
        for name, values in (
            ("", entry),
            *((f", {name}", metrics[metric]) for name, metrics in agreement["by_phantom"].items()),
        ):
            rest = f"noise alone {percent(values['floor'])}, before the fit {percent(values['before'])}"
            found = f"{percent(values['after'])} ({rest}; {values['n']} cases)"
            line(
                f"by another protocol, {NAMES[metric]}{name}", found, metric if metric in targets and not name else None
            )
    parameters = score["parameters"]
    line("error of parameters, median", percent(parameters["all"]["median_absolute_relative_error"]))
    line(
        "width of 95 % intervals, relative to the hidden strength, median",
        percent(parameters["all"]["median_relative_width"]),
    )
    for source, entry in parameters["by_equation"].items():
        line(f"95 % intervals that cover the true value, effects made by {EQUATIONS[source]}", tally(entry["covered"]))
    for name, entry in parameters["by_effect"].items():
        line(f"the same, {label(name)}", tally(entry["covered"]))
    for key in ("first_named", "gain", "ruled_out"):
        for entry in score["calibration"][key]:
            line(f"came true, {label(key)}: {entry['stated']}", tally(entry["came_true"]))
    return lines
