"""What the files of a recording are: checksums, and those facts of DICOM headers that tell of the scan alone."""

from __future__ import annotations

from pathlib import Path

import pydicom

from ..base.errors import InputError, reading
from ..io.files import files_of, sha256
from ..phantom.dicom_series import read_headers
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
    """What the headers of one series say of the scan.

    Returns
    -------
    dict
        Keys as under `nominal` of recording.yaml, lengths in mm; also spacing_mm, the pixel spacing (y, x). Facts that
        a header leaves out are left out.

    Raises
    ------
    InputError
        If the slices disagree on a fact that one scan has only one of.
    """
    with reading(folder, "a DICOM series"):
        return _facts(folder, list(read_headers(folder).values()))


def _facts(folder: Path, headers: list[pydicom.Dataset]) -> dict[str, str | float | list[float]]:
    facts: dict = {}
    for name, tag in {**TEXTS, **NUMBERS, "kernel": "ConvolutionKernel", "spacing_mm": "PixelSpacing"}.items():
        values = {_plain(name, header[tag].value) for header in headers if tag in header} - {None, ""}
        if len(values) > 1:
            there = ", ".join(sorted(map(str, values)))
            raise InputError(f"{folder}: its slices disagree on {tag} ({there}); give one uniform series")
        if values:
            facts[name] = values.pop()
    for name, tag in MEANS.items():
        values = [float(header[tag].value) for header in headers if tag in header and header[tag].value is not None]
        if values:
            facts[name] = sum(values) / len(values)
    if "spacing_mm" in facts:
        facts["spacing_mm"] = list(facts["spacing_mm"])
    return facts


def _plain(name: str, value):
    if value is None:
        return None
    if name in NUMBERS:
        return float(value)
    if name == "spacing_mm":
        return tuple(float(number) for number in value)
    # A kernel may be a name and a strength, ['Br38f', '3'].
    text = str(value) if isinstance(value, str) else "/".join(map(str, value))
    if len(text) > LONGEST_TEXT or not text.isprintable():  # of a broken header, all that follows
        raise ValueError(f"{name} is no text of DICOM")
    return text


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
        if facts.get(name) != first.get(name):
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
        if name in facts and name in nominal and facts[name] != nominal[name]:
            raise InputError(
                f"{source}: nominal.{name} is {nominal[name]}, the DICOM headers say {facts[name]}; correct or drop it"
            )
