"""Find CT slices among files by SOP class, and read the attributes of their headers.

For privacy, only the attributes in KEYWORDS are read, so that nothing about the patient is stored or quoted. SOP
classes as in DICOM PS3.4, B.5; attributes as in PS3.3, C.7.6 and C.8.2.1.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pydicom
from pydicom.config import disable_value_validation
from pydicom.datadict import dictionary_VR, tag_for_keyword
from pydicom.dataelem import RawDataElement
from pydicom.uid import (
    UID,
    CTImageStorage,
    EnhancedCTImageStorage,
    LegacyConvertedEnhancedCTImageStorage,
)

from ..base.console import note
from ..base.errors import InputError
from ..io.volumes import suffix_of

LONGEST_CODE = 16  # characters of a DICOM code string
LONGEST_FIRST = 1024  # bytes of the first element of a file, which is a length, version, character set or UID
LONGEST_QUOTE = 40  # characters of a number in a message
NUMBER_CHARACTERS = frozenset("0123456789+-.,eE \\")
NEEDED = ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "Rows", "Columns")
PIXEL = ("SamplesPerPixel", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation")
KEYWORDS = (
    *("SOPClassUID", "SOPInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID", "SeriesNumber", "AcquisitionNumber"),
    *("Modality", "ImageType", "RescaleType", "RescaleSlope", "RescaleIntercept", "ModalityLUTSequence"),
    *("PhotometricInterpretation", "NumberOfFrames", "PixelPaddingValue", "PixelPaddingRangeLimit"),
    *("GantryDetectorTilt", "LossyImageCompression", "BurnedInAnnotation", "RealWorldValueMappingSequence"),
    *("Manufacturer", "ManufacturerModelName", "ConvolutionKernel", "KVP", "SliceThickness"),
    *("DistanceSourceToDetector", "DistanceSourceToPatient", "SpiralPitchFactor", "XRayTubeCurrent", "Exposure"),
    *("CTDIvol", *NEEDED, *PIXEL),
)
TAGS = {keyword: tag_for_keyword(keyword) for keyword in KEYWORDS}
OVERLAY = "OverlayBitPosition"
OVERLAYS = [(group << 16) + 0x0102 for group in range(0x6000, 0x6020, 2)]  # up to 16 overlays (PS3.5, 7.6)
TEXTS = {"Manufacturer", "ManufacturerModelName", "ConvolutionKernel"}  # values that depend on the character set
SEQUENCES = {"ModalityLUTSequence", "RealWorldValueMappingSequence"}
BINARY = {"US": "H", "SS": "h", "UL": "I", "SL": "i", "FL": "f", "FD": "d", "UV": "Q", "SV": "q"}
BROKEN = object()  # value of attributes whose bytes cannot be decoded
UNDEFINED_LENGTH = 0xFFFFFFFF  # of sequences and of compressed pixel data (PS3.5, 7.5 and A.4)
HOUNSFIELD = "[hnsf'U]"  # UCUM code of the Hounsfield unit
EMPTY, MISSING = "an empty file", "a link to a file that is missing"
MULTI_FRAME = {EnhancedCTImageStorage, LegacyConvertedEnhancedCTImageStorage}

# Prefixes of words in ImageType (with underscores for blanks) of images that are not in HU. These are maps of
# multi-energy CT (PS3.3, C.8.15.3.10, and vendors' words), projections, renderings, differences and perfusion maps.
# Virtual monoenergetic (VMI) and virtual non-contrast images (MAT_REMOVED) are in HU.
NOT_HU = tuple(
    """MAT_SPEC MAT_FRAC MAT_VALUE MAT_MODIF EFF_ATOMIC EFFECTIVE_Z Z_EFF ZEFF RHO_Z IODINE ELECTRON_DENS RELATIVE_ED
    URIC_ACID MIP MINIP MIN_IP MAXIP MAX_IP PROJECTION_IMAGE VRT SSD VOLUME_REND CURVED SCREEN_SAVE SUBTRACT
    PERFUSION CBF CBV MTT TTP PBV TMAX DOSE_INFO DOSE_REPORT""".split()
)
SCOUTS = {"LOCALIZER", "SCOUT", "TOPOGRAM", "SURVIEW", "SCANOGRAM"}


@dataclass(frozen=True)
class Slice:
    """Path of a DICOM file, and values of its header by keyword, without missing and empty attributes."""

    path: Path
    values: dict[str, object]

    def has(self, keyword: str) -> bool:
        """Return whether the header has the attribute."""
        return keyword in self.values

    def text(self, keyword: str) -> str:
        """Return the values joined by slashes; empty if missing."""
        value = self.values.get(keyword, ())
        if value is BROKEN:
            raise InputError(f"{self.path}: {keyword} is not readable; correct it, or export the series again")
        return "/".join(value)

    def numbers(self, keyword: str, count: int = 1) -> tuple[float, ...]:
        """Return `count` finite numbers; InputError if the attribute has anything else."""
        if keyword not in self.values:
            raise InputError(f"{self.path}: has no {keyword}; export the series again with all attributes of CT slices")
        values = self.values[keyword]
        try:
            found = tuple(float(value) for value in values) if values is not BROKEN else ()
        except ValueError:
            found = ()
        if len(found) != count or not all(abs(value) < float("inf") for value in found):
            what = "a finite number" if count == 1 else f"{count} finite numbers"
            raise InputError(f"{self.path}: {keyword}{self.quoted(keyword)} is not {what}; correct it")
        return found

    def number(self, keyword: str, default: float | None = None) -> float:
        """Return the number of an attribute with one value; `default` if missing."""
        return default if default is not None and keyword not in self.values else self.numbers(keyword)[0]

    def integer(self, keyword: str, default: int | None = None) -> int:
        """Return the integer of an attribute with one value; `default` if missing."""
        value = self.number(keyword, default)
        if value != int(value):
            raise InputError(f"{self.path}: {keyword} is {value:g}; it must be a whole number")
        return int(value)

    def quoted(self, keyword: str) -> str:
        """Return the value in brackets for a message. Only numbers are quoted: a broken header may contain a name."""
        values = self.values[keyword]
        text = "" if values is BROKEN else "\\".join(values)
        return f" ({text})" if 0 < len(text) <= LONGEST_QUOTE and NUMBER_CHARACTERS.issuperset(text) else ""


class UnusedFiles:
    """Files that are not used, by reason."""

    def __init__(self):
        self.by_reason: dict[str, list[Path]] = {}
        self.headers: list[tuple[Slice, str]] = []

    def add(self, path: Path, reason: str, header: Slice | None = None) -> None:
        """Add a file, with its header if it is DICOM."""
        self.by_reason.setdefault(reason, []).append(path)
        if header is not None:
            self.headers.append((header, reason))

    def lines(self, top: Path) -> list[str]:
        """Return a line for each reason, with the number of files and the first file."""
        lines = []
        for reason, paths in self.by_reason.items():
            first = paths[0].relative_to(top) if paths[0].is_relative_to(top) else paths[0]
            count = f"{len(paths)} files, the first of them {first}" if len(paths) > 1 else str(first)
            lines.append(f"{count}: {reason}")
        return lines

    def report(self, top: Path) -> None:
        """Print a note for each reason."""
        for line in self.lines(top):
            note(f"{top}: not used: {line}")


def modality(header: pydicom.Dataset) -> str:
    """Return the modality for messages; "unreadable" if it is broken, as it may then include the patient's name."""
    return _code(str(header.get("Modality", "not given")))


def _code(code: str) -> str:
    return code if code.isalpha() and len(code) <= LONGEST_CODE else code if code == "not given" else "unreadable"


def walk_folders(root: Path, unused: UnusedFiles) -> Iterator[Path]:
    """Yield the folder and all folders below it by name, each once; links are followed.

    Hidden folders, and links to folders that were visited before, are added to `unused`.

    Raises
    ------
    InputError
        If a folder cannot be opened.
    """

    def refuse(error: OSError) -> None:
        raise InputError(f"{error.filename}: cannot be opened ({error.strerror}); change its permissions")

    seen = set()
    for name, inner, _ in os.walk(root, followlinks=True, onerror=refuse):
        folder, real = Path(name), os.path.realpath(name)
        if real in seen:
            unused.add(folder, "a link to a folder that was read before")
            inner.clear()
            continue
        seen.add(real)
        for hidden in sorted(filter(is_hidden, inner)):
            unused.add(folder / hidden, "a hidden or system folder")
        inner[:] = sorted(name for name in inner if not is_hidden(name))
        yield folder


def files_in(folder: Path) -> list[Path]:
    """List all files of a folder by name, including broken links."""
    try:
        # Virtual Phantom writes the checksum of its files to .sha256.
        paths = sorted(path for path in folder.iterdir() if not (is_hidden(path.name) and path.suffix == ".sha256"))
        return [path for path in paths if not path.is_dir()]
    except NotADirectoryError:
        raise InputError(f"{folder}: is not a folder; give a folder with one CT series") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be opened ({error.strerror}); give a folder with one CT series") from None


def is_hidden(name: str) -> bool:
    """Return whether a name belongs to a hidden file, or to a system file of Windows or macOS."""
    return name.startswith(".") or name.lower() in ("thumbs.db", "desktop.ini", "__macosx")


def slices_of(paths: Iterable[Path], unused: UnusedFiles) -> list[Slice]:
    """List the CT slices among files; add other files with a reason to `unused`.

    Raises
    ------
    InputError
        If a file cannot be read, or looks like a damaged slice.
    """
    slices = []
    candidates, others = split_dicom(paths, unused)
    for path in candidates:
        header = read_header(path)
        if header is None:
            others.append((path, "DICOM without a SOP class or a modality, so no image"))
        elif reason := _unusable(header):
            unused.add(path, reason, header)
        else:
            slices.append(header)
    add_not_dicom(others, [header.path for header in slices], unused)
    return slices


def split_dicom(paths: Iterable[Path], unused: UnusedFiles) -> tuple[list[Path], list[tuple[Path, str]]]:
    """Split paths into possible DICOM files and others, by their first bytes; add hidden files to `unused`.

    Returns
    -------
    candidates : list of Path
    others : list of (Path, str)
        Files that are not DICOM, and why, for `add_not_dicom`.
    """
    candidates, others = [], []
    for path in paths:
        if is_hidden(path.name):
            unused.add(path, "a hidden or system file")
        elif reason := not_dicom(path):
            others.append((path, reason))
        else:
            candidates.append(path)
    return candidates, others


def add_not_dicom(others: Iterable[tuple[Path, str]], used: Iterable[Path], unused: UnusedFiles) -> None:
    """Add files that are not DICOM, with their reasons, to the unused files.

    Raises
    ------
    InputError
        If a file has the suffix of used files, as it may be a damaged slice.
    """
    suffixes = {path.suffix.lower() for path in used}
    suffixes = {suffix for suffix in suffixes if not suffix[1:].isdigit()}  # names that are UIDs end in a number
    for path, reason in others:
        suffix = (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower()
        if suffix in suffixes and (suffix or reason in (EMPTY, MISSING)):
            raise InputError(f"{path}: {reason}, but named like the slices; copy it again, or move it elsewhere")
        unused.add(path, reason)


def not_dicom(path: Path) -> str:
    """Return why a file is not DICOM, by its first bytes; empty if it may be DICOM.

    DICOM files have the prefix DICM after a preamble of 128 bytes (PS3.10, 7.1), or start with an element of group 2
    or 8.

    Raises
    ------
    InputError
        If the file cannot be opened.
    """
    if not path.is_file():
        return MISSING if path.is_symlink() and not path.exists() else "not a regular file"
    try:
        with path.open("rb") as file:
            start = file.read(132)
    except OSError as error:
        raise InputError(f"{path}: cannot be opened ({error.strerror}); change its permissions") from None
    if not start:
        return EMPTY
    if start[128:] == b"DICM" or _starts_with_element(start):
        return ""
    if suffix_of(path):
        return "an image, not DICOM; to read it, give its own path"
    if start[:2] == b"PK" or start[:2] == b"\x1f\x8b" or start[:6] in (b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07"):
        return "an archive; unpack it to use what is in it"
    return "not DICOM"


def _starts_with_element(start: bytes) -> bool:
    """Return whether bytes are an element of group 2 or 8, with a value representation or a short length."""
    for order, group in (("little", start[:2]), ("big", start[1::-1])):
        if group in (b"\x02\x00", b"\x08\x00") and len(start) >= 8:
            letters = start[4:6].isalpha() and start[4:6].isupper()
            return letters or int.from_bytes(start[4:8], order) <= LONGEST_FIRST
    return False


def read_header(path: Path) -> Slice | None:
    """Read the attributes in KEYWORDS; None if the file is not DICOM, InputError if the header is damaged."""
    try:
        with disable_value_validation():  # warnings of pydicom quote the header; values are checked later
            header = pydicom.dcmread(
                path, stop_before_pixels=True, force=True, specific_tags=[*TAGS.values(), *OVERLAYS]
            )
            return _header(path, header)
    except Exception as error:  # of many types; its text may quote the header
        raise InputError(f"{path}: cannot be read as DICOM ({type(error).__name__}); is the file complete?") from None


def _header(path: Path, header: pydicom.Dataset) -> Slice | None:
    little = header.original_encoding[1] is not False
    values = {}
    for keyword, tag in TAGS.items():
        if tag not in header:
            continue
        raw = header.get_item(tag)
        if isinstance(raw, RawDataElement) and UNDEFINED_LENGTH > raw.length > len(raw.value or b""):
            raise EOFError
        if value := _plain(header, keyword, little):
            values[keyword] = value
    if any(tag in header and (header.get_item(tag).value or b"\0\0") != b"\0\0" for tag in OVERLAYS):
        values[OVERLAY] = ("present",)
    if "SOPClassUID" not in values and (stored := header.file_meta.get("MediaStorageSOPClassUID")):
        values["SOPClassUID"] = (str(stored),)
    if syntax := header.file_meta.get("TransferSyntaxUID"):
        values["TransferSyntaxUID"] = (str(syntax),)
    # Every DICOM image has one of these attributes.
    if not {"SOPClassUID", "SeriesInstanceUID", "Modality"}.intersection(values):
        return None
    return Slice(path, values)


def _plain(header: pydicom.Dataset, keyword: str, little: bool):
    """Return the values of an element as text; empty if missing, BROKEN if the bytes cannot be decoded."""
    # pydicom does not parse the bytes, as it warns, raises or rounds, depending on the kind of value.
    tag = TAGS[keyword]
    if keyword in SEQUENCES:
        return _mapping(header, tag) if keyword == "RealWorldValueMappingSequence" else ("present",)
    raw = header.get_item(tag)
    if keyword in TEXTS or not isinstance(raw, RawDataElement):
        try:
            with pydicom.config.disable_value_validation():
                value = header[tag].value
                values = [value] if isinstance(value, str | int | float) else list(value or ())
                return tuple(text for item in values if (text := str(item).strip(" \0")))
        except Exception:  # of many types
            return BROKEN
    content = raw.value or b""
    kind = dictionary_VR(tag) if raw.VR in (None, "UN") else raw.VR
    code = BINARY.get(kind[:2])
    if code is None:
        values = content.decode("latin-1").strip(" \0").split("\\")
        return tuple(value.strip(" \0") for value in values) if any(value.strip(" \0") for value in values) else ()
    size = struct.calcsize(code)
    if len(content) % size:
        return BROKEN
    return tuple(map(str, struct.unpack(f"{'<' if little else '>'}{len(content) // size}{code}", content)))


def _mapping(header: pydicom.Dataset, tag: int):
    """Return unit, slope and intercept of each real world value mapping."""
    try:
        with pydicom.config.disable_value_validation():
            return tuple(
                "|".join(
                    (
                        str(item.MeasurementUnitsCodeSequence[0].CodeValue),
                        str(item.get("RealWorldValueSlope", "")),
                        str(item.get("RealWorldValueIntercept", "")),
                    )
                )
                for item in header[tag].value
            )
    except Exception:  # a missing attribute, or a wrong type
        return BROKEN


def _unusable(header: Slice) -> str:
    """Return why a DICOM file is not a slice in HU, by its attributes; empty if it is one."""
    uid, kind = header.values.get("SOPClassUID", ()), header.values.get("Modality", ())
    code = _code(kind[0]) if kind and kind is not BROKEN else "not given"
    if not uid or uid is BROKEN:
        if code != "CT":
            return f"no SOP class, and modality is {code}, not CT"
    elif uid[0] in MULTI_FRAME:
        return f"{UID(uid[0]).name}, multi-frame; convert it to one file per slice (dcm4che: emf2sf), or to NIfTI"
    elif uid[0] != CTImageStorage:
        name = UID(uid[0]).name if UID(uid[0]).is_valid else "not readable"
        return f"SOP class is {name}, not CT"
    elif code not in ("CT", "not given"):
        return f"modality is {code}, not CT"
    words = header.values.get("ImageType", ())
    words = {word.upper().replace(" ", "_") for word in words} if words is not BROKEN else set()
    if scout := words & SCOUTS:
        return f"ImageType is {min(scout)}"
    if other := sorted(word[:LONGEST_CODE] for word in words if word.startswith(NOT_HU)):
        return f"ImageType is {other[0]}, not an image in HU"
    unit = header.values.get("RescaleType", ())
    unit = "" if unit is BROKEN or not unit else unit[0].upper()
    # US is "unspecified" (PS3.3, C.11.1.1.2).
    if unit not in ("", "HU", "US") and not unit.startswith("HOUNSFIELD"):
        return f"RescaleType is {unit if len(unit) <= LONGEST_CODE else 'not readable'}, not HU"
    return _not_gray(header)


def _not_gray(header: Slice) -> str:
    """Return why a file is not a single gray-scale slice, such as a screen capture; empty if it is one."""
    keywords = ("NumberOfFrames", "SamplesPerPixel", "BitsAllocated")
    frames, samples, bits = (header.values.get(keyword) for keyword in keywords)
    photometric = header.values.get("PhotometricInterpretation", ("MONOCHROME2",))
    if frames not in (None, BROKEN) and frames[0].isdigit() and int(frames[0]) > 1:
        return f"multi-frame ({int(frames[0])} frames); convert it to one file per slice, or to NIfTI"
    if photometric is not BROKEN and photometric[0] not in ("MONOCHROME1", "MONOCHROME2"):
        return "PhotometricInterpretation is neither MONOCHROME1 nor MONOCHROME2: a color image or screen capture"
    if samples not in (None, BROKEN) and samples[0] == "3":
        return "three samples per pixel: a color image or screen capture"
    if bits not in (None, BROKEN) and bits[0] in ("1", "8"):
        return f"BitsAllocated is {bits[0]}: a screen capture or a display window, CT slices have 16"
    return ""
