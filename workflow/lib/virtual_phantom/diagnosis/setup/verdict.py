"""What is said of a recording whose description is wrong, or that is of another object."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from ...base.errors import refusing
from ...io.files import read_text, write_text
from ...recordings.images import ImagesRecording
from ...recordings.projections import ProjectionsRecording
from ...recordings.recording import Recording
from ..assumptions import object_of, scan_section
from ..request import DiagnosisRequest
from .finding import AS_STATED, DESCRIPTION, EMPTY_BEAM, LOCATION_DIGITS, OBJECT
from .mismatch import REACH
from .orientation import OrientationFound
from .recorded import SetUp

VERDICTS = {DESCRIPTION: "description wrong", OBJECT: "another object", EMPTY_BEAM: "nothing in the beam"}
# Of recordings that are not looked at.
NOT_LOOKED = {
    "of": "line integrals",
    "kind": AS_STATED,
    "mistakes": {},
    "alike": [],
    "share_stated": 0.0,
    "share": 0.0,
    "location": {},
}


# What was searched before another object is named.
SEARCHED = {
    "line integrals": f"fits no location in the field of view, no turn, no size within {100 * REACH['size']:.0f} % and "
    "no other geometry that was tried",
    "HU inside the body": "fits no order of the voxels and no location",
}


def doubted(recording: Recording, asked: DiagnosisRequest) -> bool:
    """Whether the description of a recording is looked at."""
    return asked.settings.check_setup and isinstance(recording, ProjectionsRecording | ImagesRecording)


def write_setup(content: Mapping, path: str | Path) -> None:
    """Write SetUp.content, or NOT_LOOKED."""
    write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", path)


def read_setup(path: str | Path) -> dict:
    """SetUp.content of a file.

    Raises
    ------
    InputError
        If it is missing or something else.
    """
    with refusing(f"{path}: says nothing of a description", OSError, ValueError, KeyError, advice="make it again"):
        content = json.loads(read_text(path))
        return {key: content[key] for key in NOT_LOOKED}


def verdict(found: SetUp | OrientationFound, recording: Recording, asked: DiagnosisRequest) -> dict:
    """What diagnosis.json holds.

    Parameters
    ----------
    found : SetUp or OrientationFound
        With a kind of VERDICTS.
    """
    scanned = "the study's phantom" if asked.settings.of_phantom else object_of(asked)
    return {
        "recording": recording.name,
        "verdict": VERDICTS[found.kind],
        "sentence": sentence(recording.name, found.content, scanned),
        "locations": [],
        "effects": [],
        "ambiguous_with": {},
        "ruled_out": {},
        "fit": {},
        "held_out": {},
        "excess_removed": None,
        "unexplained": [],
        "next_measurement": [],
        "held_out_data": "none",
        "modelled": {"object": object_of(asked), "scan": scan_section(asked, recording)},
        "setup": found.content,
    }


def sentence(name: str, content: Mapping, scanned: str) -> str:
    """The verdict in words.

    Parameters
    ----------
    name : str
        Of the recording.
    content : mapping
        SetUp.content.
    scanned : str
        What was simulated, in words.
    """
    stated, share = (f"{100 * content[key]:.2g} %" for key in ("share_stated", "share"))
    if content["kind"] == EMPTY_BEAM:
        return (
            f"{name}: nothing stood in the beam, or the files are of the air scan: line integrals do not follow those "
            f"of {scanned}. No effect was tried."
        )
    if content["kind"] == OBJECT:
        return (
            f"{name}: what was scanned is not {scanned}: {share} of the variance of its {content['of']} "
            f"{SEARCHED[content['of']]}. Name the right object in the configuration. No effect was tried."
        )
    lines = "; ".join(content["mistakes"].values())
    left = f" Of the variance of {content['of']} {stated} does not fit as described, {share} so changed."
    return (
        f"{name}: the description of the scan is wrong. Change: {lines}.{'' if stated == share else left} "
        "No effect was tried."
    )


def with_location(content: Mapping, setup: Mapping, stated: Mapping[str, float]) -> dict:
    """Content of diagnosis.json for a diagnosis that continued where the object was found.

    Parameters
    ----------
    setup : mapping
        SetUp.content.
    stated : mapping of str to float
        The location that the configuration states.

    Returns
    -------
    dict
        The content with its setup and, where the object lies elsewhere than stated, a sentence more.
    """
    content = {**content, "setup": dict(setup)}
    location = setup["location"]
    if not location:
        return content
    # As fitted, with all effects; a direction that the scan does not show stays where it was.
    location = {
        name: round(content["alignment"][name]["value"], LOCATION_DIGITS) if value else value
        for name, value in location.items()
    }
    distance = math.dist(location.values(), [stated.get(name, 0.0) for name in location])
    where = "its stated location" if any(stated.values()) else "the isocenter"
    line = ", ".join(f"{name}: {value:g}" for name, value in location.items() if value or stated.get(name))
    content["sentence"] += (
        f" The object lies {distance:.3g} mm off {where}, and was compared there. State it: "
        f"diagnosis.recordings.{content['recording']}.location: {{{line}}}."
    )
    return content
