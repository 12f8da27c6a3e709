"""Output of a ranking of measurements: two tables, and a recording.yaml to fill in."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import pandas as pd
import yaml

from ...base.data import SCHEMAS
from ...base.names import label
from ...io.schema import read_schema, validate
from .measurement import DarkFrames
from .ranking import MeasurementRanking, Pair, RankedMeasurement, settles

# Keys of the existing recording that stay
KEPT = ("name", "kind", "phantom", "isocentre_mm", "scan", "corrected", "not_checked", "nominal")
SETTINGS = (
    "disc",
    "object",
    "simulation",
    "simulation_energy_kev",
    "object_exact",
    "object_uncertainty",
    "alignment",
    "location",
    "object_may_differ",
    "baseline",
    "samples",
    "view_step",
)  # of the diagnosis of the existing recording


def ranking_table(found: MeasurementRanking) -> pd.DataFrame:
    """Return the ranking with one row per measurement.

    Returns
    -------
    pandas.DataFrame
        name, recording (what to do), information_gain_nats, least_log_score, settles, and for each ambiguous pair its
        log score and correlation. The first row, "now", holds the values of the existing recordings.
    """
    return pd.DataFrame([_row(ranked) for ranked in [found.now, *found.ranked]])


def _row(ranked: RankedMeasurement) -> dict:
    measurement = ranked.measurement
    row = {
        "name": "now" if measurement is None else measurement.name,
        "recording": "the recordings that there are" if measurement is None else measurement.words,
        "information_gain_nats": ranked.gain,
        "least_log_score": ranked.least,
        "settles": settles(ranked),
    }
    for pair, score in ranked.scores.items():
        row[f"log_score: {' or '.join(pair)}"] = score
        row[f"correlation: {' or '.join(pair)}"] = ranked.alike[pair]
    return row


def similarity_table(alike: Mapping[Pair, Mapping[str, float]]) -> pd.DataFrame:
    """Return |correlation| of every two effects (ranking.effect_similarity), the most similar first.

    Returns
    -------
    pandas.DataFrame
        effect, other, one column per recording, and `together`.
    """
    rows = [
        {"effect": pair[0], "other": pair[1]} | {name or "together": value for name, value in values.items()}
        for pair, values in alike.items()
    ]
    return pd.DataFrame(rows).sort_values("together", ascending=False, na_position="last", ignore_index=True)


def best_measurement_text(found: MeasurementRanking) -> str:
    """Return the best measurement in words."""
    first = found.ranked[0]
    about = " and about ".join(" or ".join(map(label, ambiguity.fits)) for ambiguity in found.ambiguities)
    about = about or "the missing effects"
    words = f"{first.measurement.words} (+{first.gain:.1f} nats of information about {about}"
    if first.least is not None:
        words += f"; expected log score between them {first.least:.0f}, now {found.now.least:.0f}"
    return words + ")"


def recording_template(name: str, ranked: RankedMeasurement, content: Mapping, settings: Mapping, repeats: int) -> str:
    """Return the recording.yaml of a measurement, with all known entries, as commented YAML.

    Parameters
    ----------
    settings : mapping
        Section diagnosis.recordings.<name> of the configuration.
    """
    made, further = ranked.measurement, f"{name}_{ranked.measurement.name}"
    new = {key: copy.deepcopy(content[key]) for key in KEPT if key in content}
    new |= {"name": further, "repeats": [f"repeat_{number}.h5" for number in range(repeats)]}
    new["scan"] = {key: value for key, value in (new["scan"] | dict(made.scan)).items() if value is not None}
    nominal = new.get("nominal", {})
    new["nominal"] = nominal | {key: nominal[key] * factor for key, factor in made.nominal.items() if key in nominal}
    section = dict(made.section or {}) or {key: settings[key] for key in SETTINGS if settings.get(key)}
    if "simulation" in section and made.scan:
        section["simulation"] = "the file of your simulation of this scan"
    if "object" in section or "disc" in section:
        new.pop("phantom", None)
    validate(new, read_schema(SCHEMAS / "recording.schema.yaml"), "recording.yaml")
    lines = [f"Measurement: {made.words}.", "Fill in the files of the repeats, and correct all values that differ."]
    if isinstance(made, DarkFrames):
        lines += [
            "In the files of the existing recording, replace the subtracted dark field (data_dark) by the mean of the",
            "dark frames, and diagnose that recording again.",
        ]
    else:
        configured = {
            "recordings": {further: "the folder of this file"},
            "diagnosis": {
                "recordings": {further: section},
                "scanners": {"bench": {"recordings": [name, further]}},
            },
        }
        lines += ["Then add to the configuration:", *yaml.safe_dump(configured, sort_keys=False).splitlines()]
    head = "".join(f"# {line}\n" for line in lines)
    return head + yaml.safe_dump(new, sort_keys=False, allow_unicode=True)
