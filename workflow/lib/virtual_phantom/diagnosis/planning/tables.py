"""What is written of a ranking of further recordings: two tables, and a recording.yaml to fill in."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import pandas as pd
import yaml

from ...base.data import SCHEMAS
from ...base.words import label
from ...io.schema import read_schema, validate
from .measurement import DarkFrames
from .ranking import Next, Pair, Ranked, settles

KEPT = ("name", "kind", "phantom", "isocentre_mm", "scan", "corrected", "nominal")  # of the recording that there is
OF_CURRENT = ("photons", "tube_current_ma", "mas", "dose_mgy")  # of nominal: what goes with the tube current
SETTINGS = ("disc", "object", "alignment", "samples", "view_step")  # of its diagnosis


def table(found: Next) -> pd.DataFrame:
    """The ranking, a row for each further recording.

    Returns
    -------
    pandas.DataFrame
        name, recording (what is to be done), information_gain_nats, least_log_score, settles, and for each ambiguous
        pair its log score and correlation. The first row, named "now", is what the recordings tell that there are.
    """
    return pd.DataFrame([_row(one) for one in [found.now, *found.ranked]])


def _row(one: Ranked) -> dict:
    made = one.measurement
    row = {
        "name": "now" if made is None else made.name,
        "recording": "the recordings that there are" if made is None else made.words,
        "information_gain_nats": one.gain,
        "least_log_score": one.least,
        "settles": settles(one),
    }
    for pair, score in one.scores.items():
        row[f"log_score: {' or '.join(pair)}"] = score
        row[f"correlation: {' or '.join(pair)}"] = one.alike[pair]
    return row


def alike_table(alike: Mapping[Pair, Mapping[str, float]]) -> pd.DataFrame:
    """|Correlation| of every two effects, in each recording and together, the most alike first.

    Parameters
    ----------
    alike : mapping
        As next_measurement.alikeness gives it.

    Returns
    -------
    pandas.DataFrame
        effect, other, a column for each recording, and `together`.
    """
    rows = [
        {"effect": pair[0], "other": pair[1]} | {name or "together": value for name, value in values.items()}
        for pair, values in alike.items()
    ]
    return pd.DataFrame(rows).sort_values("together", ascending=False, na_position="last", ignore_index=True)


def first_words(found: Next) -> list[str]:
    """The first of the ranking in sentences."""
    if not found.ranked:
        return []
    first = found.ranked[0]
    about = " and of ".join(" or ".join(label(name) for name in one.fits) for one in found.ambiguities)
    about = about or "the effects that were named"
    words = f"{first.measurement.words} (+{first.gain:.1f} nats of information about {about}"
    if first.least is not None:
        words += f"; expected log score between them {first.least:.0f}, now {found.now.least:.0f}"
    return [words + ")"]


def recording_to_fill_in(name: str, one: Ranked, content: Mapping, settings: Mapping, repeats: int) -> str:
    """recording.yaml of a further recording, with what is known of it beforehand.

    Parameters
    ----------
    name : str
        Of the recording that it is like.
    content : mapping
        That of the recording.yaml of that recording.
    settings : mapping
        diagnosis.recordings.<name> of the configuration.

    Returns
    -------
    str
        YAML that the schema of recordings takes, with comments.
    """
    made, further = one.measurement, f"{name}_{one.measurement.name}"
    new = {key: copy.deepcopy(content[key]) for key in KEPT if key in content}
    new |= {"name": further, "repeats": [f"repeat_{number}.h5" for number in range(repeats)]}
    new["scan"] = {key: value for key, value in (new["scan"] | dict(made.scan)).items() if value is not None}
    photons = getattr(made, "photons", 1.0)
    nominal = new.get("nominal", {})
    new["nominal"] = {key: value * photons if key in OF_CURRENT else value for key, value in nominal.items()}
    section = dict(made.section or {}) or {key: settings[key] for key in SETTINGS if settings.get(key)}
    if "object" in section or "disc" in section:
        new.pop("phantom", None)
    validate(new, read_schema(SCHEMAS / "recording.schema.yaml"), "recording.yaml")
    lines = [f"To be recorded: {made.words}.", "Fill in the files of the repeats, and what turns out otherwise."]
    if isinstance(made, DarkFrames):
        lines += [
            "Put the mean of the dark frames into the files of the recording that there is, in the place of the dark",
            "field that was subtracted (data_dark), and diagnose that recording again.",
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
