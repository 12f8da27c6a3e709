"""What the files of a recording are: checksums, and those facts of DICOM headers that tell of the scan alone."""

from __future__ import annotations

import math
from pathlib import Path

from ..base.errors import InputError
from ..io.files import files_of, sha256
from ..phantom.dicom_series import Series, find_series
from .document import Document

# Nothing but what is listed here leaves a DICOM header (attributes of PS3.3 C.7.5.1, C.7.6.2 and C.8.2.1).
TEXTS = {"manufacturer": "Manufacturer", "model": "ManufacturerModelName"}
NUMBERS = {
    "tube_kvp": "KVP",
    "slice_thickness_mm": "SliceThickness",
    "source_to_detector_mm": "DistanceSourceToDetector",
    "source_to_isocentre_mm": "DistanceSourceToPatient",
    "pitch": "SpiralPitchFactor",
}
# Tube current modulation changes these from slice to slice: their mean is kept.
MEANS = {"tube_current_ma": "XRayTubeCurrent", "mas": "Exposure", "dose_mgy": "CTDIvol"}
LONGEST_TEXT = 128  # characters: two values of a DICOM long string
# Share by which numbers of different headers may differ. Over 512 pixels it adds up to a twentieth of a pixel.
ROUNDING = 1e-4
# Repeats share these, or they are no repeats.
SHARED = ("tube_kvp", "kernel", "slice_thickness_mm", "manufacturer", "model")


def checksums(document: Document) -> dict[str, str | list[str]]:
    """SHA-256 of every file of a recording.

    The names of files in a DICOM folder are left out: exports put patients' names into them.

    Returns
    -------
    dict of str to str or list of str
        By file, named as in recording.yaml; of a DICOM folder those of its files, sorted.
    """
    found: dict[str, str | list[str]] = {document.relative(document.path): sha256(document.path)}
    folders = [path for path in (*document.repeats, *document.held_out) if path.is_dir()]
    for folder in folders:
        found[document.relative(folder)] = sorted(map(sha256, files_of(folder)))
    for path in document.files:
        if path.parent not in folders:
            found[document.relative(path)] = sha256(path)
    return found


def dicom_facts(folder: Path) -> dict[str, str | float | list[float]]:
    """What the headers of the one series in a folder say of the scan, as `series_facts`."""
    return series_facts(find_series(folder))


def series_facts(series: Series) -> dict[str, str | float | list[float]]:
    """What the headers of one series say of the scan.

    Returns
    -------
    dict
        Keys as under `nominal` of recording.yaml, lengths in mm; also spacing_mm, the pixel spacing (y, x). Facts that
        a header leaves out are left out.

    Raises
    ------
    InputError
        If an attribute is no number or text, or the slices disagree on a fact that one scan has only one of.
    """
    facts: dict = {}
    for name, keyword in {**TEXTS, "kernel": "ConvolutionKernel"}.items():
        # A kernel may be a name and a strength, ['Br38f', '3'].
        values = {one.text(keyword) for one in series.slices if one.has(keyword)}
        for text in values:
            if len(text) > LONGEST_TEXT or not text.isprintable():  # of a broken header, all that follows
                raise InputError(f"{series.name}: {keyword} is no text of DICOM; correct it")
        if len(values) > 1:
            _disagree(series, keyword, sorted(values))
        if values:
            facts[name] = values.pop()
    for name, keyword in {**NUMBERS, "spacing_mm": "PixelSpacing"}.items():
        count = 2 if name == "spacing_mm" else 1
        values = [one.numbers(keyword, count) for one in series.slices if one.has(keyword)]
        for other in values[1:]:
            if not all(map(_same, other, values[0])):
                both = sorted({values[0], other}, key=str)
                _disagree(series, keyword, [str(one if count > 1 else one[0]) for one in both])
        if values:
            facts[name] = list(values[0]) if count > 1 else values[0][0]
    for name, keyword in MEANS.items():
        values = [one.number(keyword) for one in series.slices if one.has(keyword)]
        if values:
            facts[name] = sum(values) / len(values)
    return facts


def _disagree(series: Series, keyword: str, values: list[str]) -> None:
    raise InputError(f"{series.name}: its slices disagree on {keyword} ({', '.join(values)}); give one uniform series")


def _same(one: object, other: object) -> bool:
    """True if two facts differ by no more than decimal text is rounded."""
    numbers = isinstance(one, float | int) and isinstance(other, float | int)
    return math.isclose(one, other, rel_tol=ROUNDING) if numbers else one == other


def check_shared(facts: dict, first: dict, path: Path, first_path: Path) -> None:
    """Check that two series agree in every fact that repeats share.

    Parameters
    ----------
    facts, first : dict
        From `dicom_facts`.
    path, first_path : Path
        Their folders, for the message.

    Raises
    ------
    InputError
        If they do not.
    """
    for name in SHARED:
        if not _same(facts.get(name), first.get(name)):
            raise InputError(
                f"{path}: {name} is {facts.get(name)}, that of {first_path} is {first.get(name)}: these are not "
                "repeats of one scan; make a recording of each"
            )


def check_nominal(facts: dict, nominal: dict, source: Path) -> None:
    """Check that recording.yaml and the DICOM headers agree in every fact that repeats share.

    Parameters
    ----------
    facts : dict
        From `dicom_facts`.
    nominal : dict
        That of recording.yaml.
    source : Path
        What the message begins with.

    Raises
    ------
    InputError
        If they do not.
    """
    for name in SHARED:
        if name in facts and name in nominal and not _same(facts[name], nominal[name]):
            raise InputError(
                f"{source}: nominal.{name} is {nominal[name]}, the DICOM headers say {facts[name]}; correct or drop it"
            )
