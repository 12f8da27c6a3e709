"""Verdict of a diagnosis as one to five short lines, for the console, the documents and the reports.

Each function takes the content of a document and returns its lines. Numbers are formatted here, not computed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..base.names import enumerated, label
from ..physics.effect import load
from .request import LOCATION_DIGITS
from .residuals import KINDS

VERDICTS = MATCH, EXPLAINED, PARTLY_EXPLAINED, UNEXPLAINED = (
    "match",
    "mismatch explained",
    "mismatch partly explained",
    "unexplained",
)
PRACTICAL = "match for practical purposes"
SETUP_VERDICTS = {"description": "description wrong", "object": "another object", "empty": "nothing in the beam"}
# Formats of differences in images.
DIFFERENCES = {
    "hu": "{} HU",
    "contrast_percent": "contrast {} %",
    "noise_percent": "noise {} %",
    "resolution_percent": "resolution {} %",
    "features_sd": "features {} SD of repeats",
}
# Names of domains of residuals for texts, where they differ from the domain.
DOMAINS = {
    "columns": "detector columns",
    "rows": "detector rows",
    "edges": "object edges",
    "pixels": "detector pixels",
    "projections": "projection blocks",
    "alignment": "nuisance parameters",
    "both halves": "residuals common to both halves",
    "image": "image blocks",
}
MOST_LINES = 5  # of a verdict; a choice
MOST_NAMES = 4  # effects in a line; a choice
MOST_DETAILED = 2  # effects in a line with parameters, and parameters of each; a choice


@dataclass(frozen=True)
class VerdictLine:
    """One line of a verdict.

    Attributes
    ----------
    text : str
        Statement, without the full stop.
    rank : int
        Lines with the highest rank are omitted if there are more than MOST_LINES.
    """

    label: str
    text: str
    rank: int = 0

    def __str__(self) -> str:
        return f"{self.label}: {self.text}."


def verdict_of(explained: bool, remains: bool) -> str:
    """Return the verdict, by whether a mismatch is explained and whether a mismatch remains."""
    if explained:
        return PARTLY_EXPLAINED if remains else EXPLAINED
    return UNEXPLAINED if remains else MATCH


def _line(label: str, text: str, rank: int = 0) -> VerdictLine | None:
    """Return a line; None without a statement."""
    return VerdictLine(label, text, rank) if text else None


def with_verdict_text(content: Mapping, lines: Iterable[VerdictLine | None]) -> dict:
    """Add lines, in the order of display, to a document, and the same as one string under `sentence`.

    None stands for a line that does not apply.
    """
    given = [line for line in lines if line is not None]
    chosen = sorted(range(len(given)), key=lambda index: given[index].rank)[:MOST_LINES]
    written = [str(given[index]) for index in sorted(chosen)]
    return {**content, "verdict_lines": written, "sentence": " ".join(written)}


def console_text(content: Mapping) -> str:
    """Return the name and the verdict, followed by the lines of the verdict."""
    name = content.get("recording", content.get("scanner"))
    return "\n  ".join([f"{name}: {content['verdict']}", *content["verdict_lines"]])


def recording_lines(content: Mapping, stated: Mapping[str, float] | None = None) -> list[VerdictLine | None]:
    """Return the lines of the diagnosis of a recording of projections or images.

    Parameters
    ----------
    stated : mapping of str to float, optional
        Object location in the configuration, mm by axis.
    """
    below = content.get("practice", {}).get("small", [])
    at_bounds = content.get("at_bounds", [])
    named = [effect for effect in content["effects"] if effect["name"] not in (*below, *at_bounds)]
    return [
        _line("Not determined", content.get("not_determined", "")),
        _conclusion(content, named),
        _alternatives(content, [effect["name"] for effect in named]),
        _improvement(content) if named else None,
        _mismatch(content, named),
        _caution(content),
        contradiction(content),
        _corrected_object(content),
        _object_errors(content),
        _location(content, stated or {}),
        _source(content),
        _below_thresholds(content, below),
        _thresholds(content),
        _next(content, named),
    ]


def _conclusion(content: Mapping, named: Sequence[Mapping]) -> VerdictLine:
    recording, verdict = content["recording"], content["verdict"]
    if named:
        return VerdictLine("Best explanation" if content["doubts"] else "Missing physics", effects_text(named))
    if verdict == MATCH:
        text = f"none; {recording} and the simulation differ only by noise and alignment"
    elif verdict == PRACTICAL:
        text = "none that is clinically relevant; image differences are below all thresholds"
    elif "removes" in content.get("object", {}):
        (piece,) = content["object"]["pieces"]
        return VerdictLine("Local object mismatch", piece_text(piece))
    elif contradiction(content):
        text = "none; a declared value contradicts the data"
    else:
        text = "unknown; no effect of Virtual Phantom explains the difference"
        if content.get("at_bounds"):
            best = enumerated(list(map(effect_name, content["at_bounds"])))
            text += f"; {best} fits best, but with a parameter at its bound"
    return VerdictLine("Missing physics", text)


def _alternatives(content: Mapping, names: Sequence[str]) -> VerdictLine | None:
    replaced: dict[str, list[str]] = {}
    for name in names:
        if rivals := _rivals(content, name):
            replaced.setdefault(" or ".join(rivals), []).append(effect_name(name))
    found = [rivals + f" instead of {' or '.join(effects)}" * (len(names) > 1) for rivals, effects in replaced.items()]
    return _line("Indistinguishable alternatives", "; ".join(found[:MOST_DETAILED]), rank=5)


def _rivals(content: Mapping, name: str) -> list[str]:
    """Return the names of alternatives that explain the data as well as an effect."""
    rivals = shortened([effect_name(rival) for rival in content["ambiguous_with"].get(name, [])])
    if other := content.get("outside", {}).get(name):
        rivals.append(f"an unmodeled change that {other['what']}")
    if other := content.get("object_alternatives", {}).get(name):
        rivals.append(f"an object error ({other['what']})")
    return rivals


def _improvement(content: Mapping) -> VerdictLine | None:
    """Return the RMS beyond noise before and after the fit; the total RMS if the effects do not reduce it."""
    name = next((key for key in content["held_out"] if key.startswith("rms_")), None)
    if content["excess_removed"] is None or name is None:
        return None
    rms, unit = content["held_out"][name], " HU" if name == "rms_hu" else ""
    before, after, noise = rms["before"], rms["after"], rms["floor"]
    removed, share = content.get("excess_rms_removed"), ""
    if removed is not None and removed > 0:
        before, after = (math.sqrt(max(0.0, value**2 - noise**2)) for value in (before, after))
        share = f" ({percent(removed, content)} removed)"
    name = f"{'excess ' * bool(share)}RMS{'' if unit else ' of line integrals'}"
    text = f"{name} {before:.3g} -> {after:.3g}{unit}{share}; noise {noise:.3g}{unit}"
    return VerdictLine("Fit on held-out data", text, rank=2)


def percent(share: float, content: Mapping) -> str:
    """Return a share in percent; never "100 %" if a mismatch or a doubt remains."""
    text = f"{100 * share:.3g}"
    remains = share < 1 or content.get("unexplained") or content.get("doubts")
    return "over 99.9 %" if text == "100" and remains else f"{text} %"


def _mismatch(content: Mapping, named: Sequence[Mapping]) -> VerdictLine | None:
    """Return the largest difference that no effect explains, and its size in images."""
    practice = content.get("practice", {})
    if "removes" in content.get("object", {}):
        share = percent(content["object"]["removes"], content)
        text = f"correcting the object removes {share} of the difference, more than any effect"
        return VerdictLine("Fit on held-out data", text, rank=2)
    if named and content["unexplained"]:
        size = practice.get("remaining", {}).get("hu")
        worst = content["unexplained"][0]
        text = f"{'' if worst['domain'] == KINDS else 'largest in '}{location_text(worst)}"
        if size is not None and abs(size["value"]) > 2 * size["error"]:
            hu = float(f"{abs(size['value']):.2g}")  # two digits
            text += f"; up to {hu:g} HU in images"
        return VerdictLine("Remaining mismatch", text, rank=3)
    if not named and content["verdict"] == UNEXPLAINED:
        found = [DIFFERENCES[name].format(f"{value:.3g}") for name, value in practice.get("differing", {}).items()]
        text = location_text(content["locations"][0]) + (f"; in images: {', '.join(found)}" if found else "")
        return VerdictLine("Largest mismatch", text, rank=2)
    return None


def location_text(location: Mapping) -> str:
    """Return the location of a difference between recording and simulation, for texts."""
    domain, where = location["domain"], location["where"]
    return f"a change that {where}" if domain == KINDS else f"{DOMAINS.get(domain, domain)} ({where})"


def _caution(content: Mapping) -> VerdictLine | None:
    """Return the first doubt about the effects, or the first remark on the data if there is no doubt."""
    doubts, remarks = content.get("doubts", []), content.get("caveats", [])
    if doubts:
        more = f"{len(doubts) - 1} more in the report" if len(doubts) > 1 else "other physics may be missing too"
        return VerdictLine("Caution", f"{doubts[0]}; {more}", rank=1)
    if remarks:
        return VerdictLine("Caution", remarks[0].partition(". ")[0].rstrip("."), rank=3)
    return None


def contradiction(content: Mapping, of: str = "") -> VerdictLine | None:
    """Return the declared values that the data contradict; `of` follows each effect's name."""
    contradicted = [
        f"{effect_name(name)}{of}: {parameter_name(name, key)} {found['value']:.3g} "
        f"({found['ci95'][0]:.3g} to {found['ci95'][1]:.3g}){_unit(found['unit'])}, "
        f"declared {found['stated']:g} ± {found['sd']:g}"
        for name, parameters in content.get("declared", {}).items()
        for key, found in parameters.items()
        if found["off"]
    ]
    return _line("Contradicts declared physics", "; ".join(contradicted), rank=1)


def _corrected_object(content: Mapping) -> VerdictLine | None:
    found = content.get("object", {})
    pieces = [piece_text(piece) for piece in found["pieces"]] if found.get("corrected") else []
    return _line("Object corrected before the fit", enumerated(pieces), rank=2)


def _object_errors(content: Mapping) -> VerdictLine | None:
    """Return the errors of the object that the data need, and the effects that explain them too."""
    found = content.get("object_errors", {})
    alike = " or ".join(shortened([effect_name(name) for name in found.get("imitated_by", [])]))
    text = found.get("what", "") + (f"; {alike} would explain this, too" if alike else "")
    return _line("Object as fitted", text, rank=3)


def piece_text(piece: Mapping) -> str:
    """Return the position, diameter and HU of a local object mismatch, for texts."""
    kind = "rod along z" if piece["z_mm"] is None else "ball"
    position = ", ".join(f"{axis} {piece[f'{axis}_mm']:.3g}" for axis in "xyz" if piece[f"{axis}_mm"] is not None)
    sign = "more" if piece["hu"] > 0 else "less"
    return f"{piece['width_mm']:.3g} mm {kind} at {position} mm, {abs(piece['hu']):.3g} HU {sign} than stated"


def _location(content: Mapping, stated: Mapping[str, float]) -> VerdictLine | None:
    """Return the fitted object location if it lies far off the stated one."""
    location = content.get("setup", {}).get("location")
    if not location:
        return None
    # The location as fitted. A direction that the scan does not show keeps its value.
    location = {
        name: round(content["alignment"][name]["value"], LOCATION_DIGITS) if value else value
        for name, value in location.items()
    }
    axes = [name for name in location if name != "turn_deg"]
    distance = math.dist([location[name] for name in axes], [stated.get(name, 0.0) for name in axes])
    where = "its stated location" if any(stated.values()) else "the isocenter"
    if "turn_deg" in location:  # images, which are always registered
        turn = content["alignment"]["turn_deg"]["value"]
        ends = ", seen from its other end" if content["setup"].get("mirrored") else ""
        text = f"registered {distance:.3g} mm off {where}, rotated by {turn:.2g} degrees{ends}"
        return VerdictLine("Object location", text, rank=4)
    line = ", ".join(f"{name}: {value:g}" for name, value in location.items() if value or stated.get(name))
    key = f"diagnosis.recordings.{content['recording']}.location"
    return VerdictLine("Object location", f"{distance:.3g} mm off {where}; set {key}: {{{line}}}", rank=1)


def _source(content: Mapping) -> VerdictLine | None:
    source = next((effect["taken_from"] for effect in content["effects"] if "taken_from" in effect), None)
    if source is None:
        return None
    left = ", ".join(map(effect_name, content["not_taken"]))
    text = f"transferred from {source}; only the alignment is fitted" + (f"; not transferred: {left}" if left else "")
    return VerdictLine("Source of the physics", text, rank=1)


def _below_thresholds(content: Mapping, names: Sequence[str]) -> VerdictLine | None:
    listed = shortened([" or ".join([effect_name(name), *_rivals(content, name)]) for name in names])
    return _line("Also significant, below the relevance thresholds", ", ".join(listed), rank=4)


def _thresholds(content: Mapping) -> VerdictLine | None:
    """Return the relevance thresholds if the verdict depends on them."""
    thresholds = content["practice"]["thresholds"] if content["verdict"] == PRACTICAL else {}
    limits = [DIFFERENCES[name].format(f"{value:g}") for name, value in thresholds.items()]
    return _line("Relevance thresholds", ", ".join(limits), rank=5)


def _next(content: Mapping, named: Sequence[Mapping]) -> VerdictLine | None:
    """Return the measurement that would resolve an ambiguity, or confirm the first effect."""
    if content["next_measurement"]:
        return VerdictLine("Next", content["next_measurement"][0], rank=6)
    if not named or "taken_from" in named[0]:
        return None
    name = named[0]["name"]
    test = load(name).settled_by.partition(":")[0]
    return VerdictLine("Next", f"to confirm {effect_name(name)}, {test}", rank=6)


def setup_lines(setup: Mapping, scanned: str) -> list[VerdictLine | None]:
    """Return the lines for a scan with a wrong set-up or object; `scanned` describes the object as configured."""
    described, corrected = (f"{100 * setup[key]:.2g} %" for key in ("share_stated", "share"))
    variance = f"Unexplained variance of {setup['of']}"
    tried = VerdictLine("Effects", "none fitted; correct the set-up first")
    if setup["kind"] == "empty":
        return [
            VerdictLine("Empty beam", f"line integrals are not correlated with those of {scanned}"),
            VerdictLine("Next", "check that the repeats in recording.yaml are scans of the object, not air scans"),
            tried,
        ]
    if setup["kind"] == "object":
        images = setup["of"] != "line integrals"
        searched = "voxel orders and locations" if images else "locations, angles, sizes and geometries"
        return [
            VerdictLine("Wrong object", f"the scan does not show {scanned}"),
            VerdictLine(variance, f"at least {corrected} for all tested {searched}"),
            VerdictLine("Next", "state the scanned object and all else in the beam, such as a table"),
            tried,
        ]
    changed = f"{described} with the stated set-up, {corrected} after correction" if described != corrected else ""
    mistakes = setup["mistakes"]
    return [
        VerdictLine("Scan set-up error", "; ".join(mistakes)),
        VerdictLine("Correction", "; ".join(mistakes.values())),
        _line(variance, changed),
        tried,
    ]


def scanner_lines(content: Mapping) -> list[VerdictLine | None]:
    """Return the lines of the joint diagnosis of a scanner's recordings."""
    recordings = content["recordings"]
    tests = [name for name, recording in recordings.items() if recording["test"]]
    unexplained = [name for name, recording in recordings.items() if recording["unexplained"]]
    disagreement = _disagreement(recordings)
    count = len(recordings) - len(tests)
    if content["effects"]:
        shared = f"{effects_text(content['effects'])}, in {count} recordings"
    elif unexplained or disagreement:
        shared = "unknown; no shared effect explains the differences"
    else:
        shared = f"none; {len(recordings)} recordings agree with the simulation"
    remaining = f"in {', '.join(unexplained)}" if unexplained else ""
    return [
        VerdictLine("Shared missing physics", shared),
        _removed("Fit on held-out recordings", content["excess_rms_removed"]),
        _removed(f"Fit on {', '.join(tests)} (not used for selection)", content["excess_rms_removed_in_tests"]),
        contradiction(content),
        *(
            contradiction({"declared": declared}, f" of protocol {key}")
            for key, declared in content["declared_of_protocols"].items()
        ),
        disagreement,
        _line("Remaining mismatch", remaining, rank=3),
    ]


def _removed(subject: str, removed: Mapping[str, float] | None) -> VerdictLine | None:
    if removed is None:
        return None
    median, worst = (round(100 * removed[key]) for key in ("median", "worst"))
    return VerdictLine(subject, f"{median} % of the excess RMS removed (median; worst {worst} %)", rank=2)


def _disagreement(recordings: Mapping[str, Mapping]) -> VerdictLine | None:
    """Return which recordings disagree with the others on shared parameters."""
    agreement = {name: recording["agreement"] for name, recording in recordings.items()}
    fitted = [name for name, recording in recordings.items() if not recording["test"]]
    off = [name for name, found in agreement.items() if found and found["disagrees"]]
    if not off:
        return None
    if 2 * len([name for name in off if name in fitted]) > len(fitted):  # no single one stands out
        text = f"{', '.join(fitted)} disagree with each other on shared parameters"
        off = [name for name in off if name not in fitted]
        text += f"; also {', '.join(off)}" if off else ""
    else:
        verb, others = "disagrees" if len(off) == 1 else "disagree", agreement[off[0]]["against"]
        text = f"{', '.join(off)} {verb} with {', '.join(others)} on shared parameters; compare dates and settings"
    return VerdictLine("Disagreement", text, rank=1)


def feature_lines(content: Mapping) -> list[VerdictLine | None]:
    """Return the lines of a diagnosis of features."""
    if content["verdict"] == MATCH:
        return [VerdictLine("Differing image property", "none; features differ by no more than between repeats")]
    worst = VerdictLine("Largest mismatch", _feature_location(content["locations"][0]))
    if not content["effects"]:
        name, best = next(iter(content["candidates"].items()))
        nearest = f"{label(name)}, which removes {100 * best['held_out']:.0f} % of the difference on held-out regions"
        return [
            VerdictLine("Differing image property", "unknown; no single property explains the difference"),
            worst,
            VerdictLine("Closest property", nearest) if best["held_out"] > 0 else None,
            _next(content, []),
        ]
    (effect,) = content["effects"]
    rivals = [label(name) for name in content["ambiguous_with"].get(effect["name"], [])]
    removed = f"{100 * effect['evidence']['held_out_gain']:.0f} % of the difference removed"
    remaining = [_feature_location(location) for location in content["unexplained"][:1]]
    return [
        VerdictLine("Differing image property", " or ".join([label(effect["name"]), *rivals])),
        VerdictLine("Fit on held-out regions", removed),
        worst,
        _line("Remaining mismatch", "".join(remaining)),
        _next(content, []),
    ]


def _feature_location(location: Mapping) -> str:
    domain, where = location["domain"], location["where"]
    return f"{domain}s of {where}" if domain in ("mean", "SD") else f"{domain} ({where})"


def effects_text(effects: Sequence[Mapping]) -> str:
    """Return effects of diagnosis.json by name, a few of them with their parameters."""
    detailed = len(effects) <= MOST_DETAILED
    return enumerated(shortened([_effect_text(effect, detailed) for effect in effects]))


def _effect_text(effect: Mapping, detailed: bool) -> str:
    name, parameters = effect["name"], list(effect.get("parameters", {}).items())[:MOST_DETAILED]
    if not detailed or not parameters:
        return effect_name(name)
    values = [f"{parameter_name(name, key)} {found['value']:.3g}{_unit(found['unit'])}" for key, found in parameters]
    return f"{effect_name(name)} ({', '.join(values)})"


def effect_name(name: str) -> str:
    """Return the name of an effect for texts."""
    return load(name).display_name


def parameter_name(effect: str, key: str) -> str:
    """Return the name of a parameter of an effect for texts, without its unit."""
    parameters = {parameter.name: parameter for parameter in load(effect).parameters}
    return parameters[key].display_name if key in parameters else label(key)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def shortened(names: list[str]) -> list[str]:
    """Return the first names, and how many others there are."""
    return names if len(names) <= MOST_NAMES else [*names[: MOST_NAMES - 1], f"{len(names) - MOST_NAMES + 1} more"]
