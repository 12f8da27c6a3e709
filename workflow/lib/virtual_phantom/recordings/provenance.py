"""Checksums of a recording's files, and facts about the scan from DICOM headers."""

from __future__ import annotations

import math
from pathlib import Path

from ..base.errors import InputError
from ..io.files import files_of, sha256
from ..phantom.dicom_series import Series
from .document import Document

# Only these attributes are copied from DICOM headers (PS3.3 C.7.5.1, C.7.6.2 and C.8.2.1): no patient data.
TEXTS = {"manufacturer": "Manufacturer", "model": "ManufacturerModelName", "kernel": "ConvolutionKernel"}
NUMBERS = {
    "tube_kvp": "KVP",
    "slice_thickness_mm": "SliceThickness",
    "source_to_detector_mm": "DistanceSourceToDetector",
    "source_to_isocentre_mm": "DistanceSourceToPatient",
    "pitch": "SpiralPitchFactor",
    "spacing_mm": "PixelSpacing",
}
# Tube current modulation changes these from slice to slice; the mean is used.
MEANS = {"tube_current_ma": "XRayTubeCurrent", "mas": "Exposure", "dose_mgy": "CTDIvol"}
LONGEST_TEXT = 128  # characters: two values of a DICOM long string
# Relative difference allowed between numbers of different headers: over 512 pixels it adds up to 1/20 pixel.
ROUNDING = 1e-4
# Repeats of one scan agree in these.
SHARED = ("tube_kvp", "kernel", "slice_thickness_mm", "manufacturer", "model")


def checksums(document: Document) -> dict[str, str | list[str]]:
    """Return the SHA-256 of every file of a recording, by its name in recording.yaml.

    A DICOM folder has a sorted list. Its file names are omitted, because exports put patient names into them.
    """
    found: dict[str, str | list[str]] = {document.relative(document.path): sha256(document.path)}
    folders = [path for path in (*document.repeats, *document.held_out) if path.is_dir()]
    for folder in folders:
        found[document.relative(folder)] = sorted(map(sha256, files_of(folder)))
    for path in document.files:
        if path.parent not in folders:
            found[document.relative(path)] = sha256(path)
    return found


def series_facts(series: Series) -> dict[str, str | float | list[float]]:
    """Return scan facts from the headers of one series.

    Returns
    -------
    dict
        Keys as under `nominal` of recording.yaml, lengths in mm; also spacing_mm, the pixel spacing (y, x). Absent
        attributes are omitted.

    Raises
    ------
    InputError
        If an attribute has an invalid value, or the slices disagree on an attribute that is constant in one scan.
    """
    facts: dict = {}
    for name, keyword in TEXTS.items():
        # A kernel may be a name and a strength, ['Br38f', '3'].
        values = {header.text(keyword) for header in series.slices if header.has(keyword)}
        for text in values:
            if len(text) > LONGEST_TEXT or not text.isprintable():  # a damaged header may include everything after it
                raise InputError(f"{series.name}: {keyword} is not valid DICOM text; correct or remove it")
        if len(values) > 1:
            _disagree(series, keyword, sorted(values))
        if values:
            facts[name] = values.pop()
    for name, keyword in NUMBERS.items():
        count = 2 if name == "spacing_mm" else 1
        values = [header.numbers(keyword, count) for header in series.slices if header.has(keyword)]
        for other in values[1:]:
            if not all(map(_same, other, values[0])):
                pair = sorted({values[0], other}, key=str)
                _disagree(series, keyword, [str(value if count > 1 else value[0]) for value in pair])
        if values:
            facts[name] = list(values[0]) if count > 1 else values[0][0]
    for name, keyword in MEANS.items():
        values = [header.number(keyword) for header in series.slices if header.has(keyword)]
        if values:
            facts[name] = sum(values) / len(values)
    return facts


def _disagree(series: Series, keyword: str, values: list[str]) -> None:
    raise InputError(
        f"{series.name}: slices disagree on {keyword} ({', '.join(values)}); use one series per folder, from one scan"
    )


def _same(first: object, second: object) -> bool:
    """Return whether two facts are equal, numbers up to ROUNDING."""
    numbers = isinstance(first, float | int) and isinstance(second, float | int)
    return math.isclose(first, second, rel_tol=ROUNDING) if numbers else first == second


def check_shared(facts: dict, first: dict, path: Path, first_path: Path) -> None:
    """Check that the `series_facts` of two series (folders `path` and `first_path`) agree in SHARED.

    Raises
    ------
    InputError
        If they do not.
    """
    for name in SHARED:
        if not _same(facts.get(name), first.get(name)):
            raise InputError(
                f"{path}: {name} is {facts.get(name)}, but {first_path} has {first.get(name)}; repeats must come from "
                "one scan: make a separate recording of each"
            )


def check_nominal(facts: dict, nominal: dict, source: Path) -> None:
    """Check that `nominal` of recording.yaml (path `source`) and the `series_facts` agree in SHARED.

    Raises
    ------
    InputError
        If they do not.
    """
    for name in SHARED:
        if name in facts and name in nominal and not _same(facts[name], nominal[name]):
            raise InputError(
                f"{source}: nominal.{name} is {nominal[name]}, but the DICOM headers say {facts[name]}; correct or "
                "remove it"
            )
