"""Convert the stored values of CT slices to HU.

SimpleITK decodes only compressed pixel data, not whole files: it would invert MONOCHROME1, which only concerns the
display (PS3.3, C.7.6.3.1.2).
"""

from __future__ import annotations

import functools
import io
import tempfile
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pydicom
import SimpleITK as sitk
from pydicom.config import disable_value_validation
from pydicom.dataelem import RawDataElement
from pydicom.uid import UID, DeflatedExplicitVRLittleEndian, SecondaryCaptureImageStorage
from scipy import ndimage

from ..base.console import note
from ..base.errors import InputError
from ..base.units import HU_AIR
from ..io.volumes import GZIP_MOST
from .dicom_files import BROKEN, HOUNSFIELD, OVERLAY, UNDEFINED_LENGTH, Slice

START = b"\xe0\x7f\x10\x00OB\0\0\xff\xff\xff\xff"  # start of the element of encapsulated pixel data
END = b"\xfe\xff\xdd\xe0\0\0\0\0"  # its delimiter
SIZE = ("Rows", "Columns", "SamplesPerPixel", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation")
# Padding above this value looks like tissue. Values below are air or outside of the scanned circle.
TISSUE_HU = -900.0
WATER_TO_AIR_HU = 1000.0  # by the definition of the scale
# Scanners store HU - 1024 in 12 bits, or up to 30,710 HU in the extended scale (Siemens); more is no CT number.
HIGHEST_HU = 31_743.0  # 2^15 - 1 - 1024


def check_pixels(slices: Sequence[Slice], name: object) -> None:
    """Check before reading pixels that all slices are stored in the same way and can be converted to HU.

    Parameters
    ----------
    name : object
        Start of messages about the series.

    Raises
    ------
    InputError
        If an attribute is missing, invalid for CT, or differs between slices.
    """
    first = slices[0]
    for header in slices:
        _check(header)
        if header.integer("PixelRepresentation") != first.integer("PixelRepresentation"):
            raise InputError(
                f"{header.path}: PixelRepresentation differs from {first.path.name}, so one of them has the wrong "
                "sign; correct it"
            )
    _check_rescale(slices, name)
    _note(
        slices,
        name,
        "PhotometricInterpretation",
        ("MONOCHROME1",),
        "it only concerns the display; values are used as stored",
    )
    _note(slices, name, "LossyImageCompression", ("01",), "values were changed by lossy compression")
    _note(slices, name, "BurnedInAnnotation", ("YES",), "there may be text in the image")
    for word in ("MPR", "AVERAGE", "REFORMATTED"):
        if any(word in header.text("ImageType").split("/") for header in slices):
            note(f"{name}: ImageType is {word}: a reformatted image, whose noise is not the scanner's")


def _check_rescale(slices: Sequence[Slice], name: object) -> None:
    """Reject a rescale that differs in a minority of slices; without a majority, slices were scaled individually."""
    pairs = [(header.number("RescaleSlope"), header.number("RescaleIntercept")) for header in slices]
    (usual, count), *others = Counter(pairs).most_common()
    if not others:
        return
    odd = pairs.index(others[0][0])
    words = "RescaleSlope and RescaleIntercept"
    if count > len(slices) / 2:
        raise InputError(
            f"{slices[odd].path}: {words} are {pairs[odd][0]:g} and {pairs[odd][1]:g}, but {usual[0]:g} "
            f"and {usual[1]:g} in most slices; correct them"
        )
    note(f"{name}: {words} differ between slices; each slice is read with its own")


def _note(slices: Sequence[Slice], name: object, keyword: str, value: tuple[str, ...], meaning: str) -> None:
    count = sum(header.values.get(keyword) == value for header in slices)
    if count:
        note(f"{name}: {keyword} is {value[0]} in {count} of {len(slices)} slices: {meaning}")


def _check(header: Slice) -> None:
    if header.has("ModalityLUTSequence"):
        raise InputError(f"{header.path}: has a ModalityLUTSequence instead of RescaleSlope; export it with HU")
    if missing := [keyword for keyword in ("RescaleSlope", "RescaleIntercept") if not header.has(keyword)]:
        raise InputError(f"{header.path}: has no {' and '.join(missing)}, so its values cannot be turned into HU")
    slope, intercept = header.number("RescaleSlope"), header.number("RescaleIntercept")
    if not header.has("PhotometricInterpretation"):
        raise InputError(f"{header.path}: has no PhotometricInterpretation; export the series again")
    if header.text("PhotometricInterpretation") not in ("MONOCHROME1", "MONOCHROME2"):
        raise InputError(f"{header.path}: PhotometricInterpretation is not MONOCHROME1 or MONOCHROME2; correct it")
    if header.integer("SamplesPerPixel") != 1:
        raise InputError(f"{header.path}: SamplesPerPixel is {header.integer('SamplesPerPixel')}; a CT slice has 1")
    if header.integer("NumberOfFrames", 1) != 1:
        raise InputError(
            f"{header.path}: NumberOfFrames is {header.integer('NumberOfFrames')}; give one file per slice"
        )
    allocated, stored, high = (header.integer(key) for key in ("BitsAllocated", "BitsStored", "HighBit"))
    if allocated not in (16, 32):
        raise InputError(f"{header.path}: BitsAllocated is {allocated}; CT slices have 16")
    if not 8 < stored <= allocated or high != stored - 1:
        raise InputError(
            f"{header.path}: BitsStored {stored} and HighBit {high} do not fit BitsAllocated {allocated}; correct them"
        )
    if abs(slope) * 2**stored < WATER_TO_AIR_HU:
        raise InputError(
            f"{header.path}: RescaleSlope is {slope:g}, so all values of {stored} bits lie within "
            f"{abs(slope) * 2**stored:.3g} HU, less than from air to water; correct it"
        )
    if header.integer("PixelRepresentation") not in (0, 1):
        raise InputError(
            f"{header.path}: PixelRepresentation is {header.integer('PixelRepresentation')}; it must be 0 or 1"
        )
    _check_length(header)
    if header.has("RealWorldValueMappingSequence"):
        _check_mapping(header, slope, intercept)


def _check_mapping(header: Slice, slope: float, intercept: float) -> None:
    """Check that real world values (PS3.3, C.7.6.16.2.11) are in HU and agree with the rescale."""
    mappings = header.values["RealWorldValueMappingSequence"]
    if mappings is BROKEN:
        raise InputError(f"{header.path}: RealWorldValueMappingSequence is not readable; remove it if values are in HU")
    for mapping in mappings:
        unit, *numbers = mapping.split("|")
        if unit != HOUNSFIELD:
            raise InputError(
                f"{header.path}: RealWorldValueMappingSequence gives another unit than HU; give images in HU"
            )
        try:
            same = np.allclose([float(number) for number in numbers], [slope, intercept], rtol=1e-6)
        except ValueError:
            same = False
        if not same:
            raise InputError(
                f"{header.path}: RealWorldValueMappingSequence and RescaleSlope disagree on HU; remove the wrong one"
            )


def read_into(slices: Sequence[Slice], array: np.ndarray, name: object) -> None:
    """Read the HU of slices that `check_pixels` accepted into an array of float32 (slices, rows, columns).

    Raises
    ------
    InputError
        If pixel data are missing, damaged, not of the size in the header, or not in HU.
    """
    padded = 0
    for header, target in zip(slices, array, strict=True):
        stored, padding = _stored(header), _padding(header)
        scaled = stored * np.float64(header.number("RescaleSlope"))
        scaled += header.number("RescaleIntercept")
        target[:] = scaled
        if padding is not None:
            outside = _outside(stored, padding, scaled)
            target[outside] = HU_AIR
            padded += np.count_nonzero(outside)
        if (highest := float(target.max())) > HIGHEST_HU:
            raise InputError(
                f"{header.path}: values reach {highest:.0f} HU, which no CT has; is PixelRepresentation (signed or "
                "not) or RescaleSlope wrong?"
            )
    if padded:
        note(
            f"{name}: {padded} voxels at the border of the slices have PixelPaddingValue, which would be tissue in HU; "
            "they are read as air"
        )


def same_pixels(header: Slice, other: Slice) -> bool:
    """Return whether two slices have the same values in HU."""
    hu = [_stored(item) * item.number("RescaleSlope") + item.number("RescaleIntercept") for item in (header, other)]
    return np.array_equal(*hu)


def _outside(stored: np.ndarray, padding: tuple[int, int], hu: np.ndarray) -> np.ndarray:
    """Return pixels with a padding value that looks like tissue or metal and that are connected to the border."""
    # Tissue may have the same value by chance, so pixels within the body are not changed.
    mask = (stored >= padding[0]) & (stored <= padding[1])
    if not mask.any() or hu[mask].max() < TISSUE_HU:
        return np.zeros_like(mask)
    labels, _ = ndimage.label(mask)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    return np.isin(labels, border[border > 0])


def _stored(header: Slice) -> np.ndarray:
    """Return the stored values in 64 bits, to avoid overflow."""
    element, little = _pixel_data(header)
    rows, columns = header.integer("Rows"), header.integer("Columns")
    allocated, signed = header.integer("BitsAllocated"), header.integer("PixelRepresentation") == 1
    if getattr(element, "length", 0) == UNDEFINED_LENGTH:
        return _decompressed(header, element.value).astype(np.int64)
    kind = np.dtype(f"{'<' if little else '>'}{'i' if signed else 'u'}{allocated // 8}")
    needed, available = rows * columns * kind.itemsize, len(element.value)
    # Writers pad with zeros, to an even length or, rarely, by a row.
    padded = needed <= available < needed + 2 * columns * kind.itemsize and not any(element.value[needed:])
    if not padded:
        raise InputError(
            f"{header.path}: its header says {rows} x {columns} pixels, which the file does not hold ({available} "
            f"bytes of PixelData, {needed} are needed); is the file complete?"
        )
    raw = np.frombuffer(element.value, kind, rows * columns).reshape(rows, columns)
    return _trimmed(header, raw.astype(np.int64))


def _pixel_data(header: Slice) -> tuple[RawDataElement, bool]:
    """Return the element with the pixels, and whether the bytes are little-endian."""
    try:
        with disable_value_validation():
            dataset = pydicom.dcmread(header.path, force=True, specific_tags=["PixelData"])
            element = dataset.get_item("PixelData")
    except Exception as error:  # of many types; its text may quote the header
        raise InputError(
            f"{header.path}: cannot be read as DICOM ({type(error).__name__}); is the file complete?"
        ) from None
    if element is None or not element.value:
        raise InputError(f"{header.path}: has no PixelData; is the file complete?")
    return element, dataset.original_encoding[1] is not False


def _trimmed(header: Slice, raw: np.ndarray) -> np.ndarray:
    """Remove the bits above the stored bits, which contain overlays in old files."""
    stored, signed = header.integer("BitsStored"), header.integer("PixelRepresentation")
    if stored == header.integer("BitsAllocated"):
        return raw
    low, top = (-(1 << stored - 1), (1 << stored - 1) - 1) if signed else (0, (1 << stored) - 1)
    beyond = (raw < low) | (raw > top)
    if not beyond.any():
        return raw
    if header.has(OVERLAY):
        kept = raw & (1 << stored) - 1
        return np.where(kept > top, kept - (1 << stored), kept)
    if (padding := _padding(header)) is not None:
        beyond &= (raw < padding[0]) | (raw > padding[1])
    if beyond.any():
        raise InputError(
            f"{header.path}: has values beyond its {stored} bits stored, so BitsStored or PixelRepresentation is "
            "wrong; correct it"
        )
    return raw


def _padding(header: Slice) -> tuple[int, int] | None:
    """Return the range of padding values, with the sign of the pixels; None if there is none."""
    if not header.has("PixelPaddingValue"):
        return None
    bits, signed, ends = header.integer("BitsAllocated"), header.integer("PixelRepresentation"), []
    for keyword in ("PixelPaddingValue", "PixelPaddingRangeLimit"):
        value = header.integer(keyword, ends[0] if ends else None)
        # The attribute may be written as US or SS regardless of PixelRepresentation.
        value %= 1 << bits if value >= 0 or bits == 32 else 1 << 16
        ends.append(value - (1 << bits) if signed and value >= 1 << bits - 1 else value)
    return min(ends), max(ends)


@functools.lru_cache(maxsize=4)
def _bare_header(syntax: str, size: tuple[int, ...]) -> bytes:
    """Return the header of a minimal DICOM file for a decoder; `size` has the values of SIZE."""
    bare = pydicom.Dataset()
    bare.file_meta = pydicom.dataset.FileMetaDataset()
    bare.file_meta.TransferSyntaxUID = syntax
    bare.SOPClassUID = bare.file_meta.MediaStorageSOPClassUID = SecondaryCaptureImageStorage
    bare.SOPInstanceUID = bare.file_meta.MediaStorageSOPInstanceUID = "1.2.3"
    bare.Modality, bare.PhotometricInterpretation = "OT", "MONOCHROME2"
    for keyword, value in zip(SIZE, size, strict=True):
        setattr(bare, keyword, value)
    file = io.BytesIO()
    bare.save_as(file, enforce_file_format=True)
    return file.getvalue()


def _decompressed(header: Slice, encoded: bytes) -> np.ndarray:
    """Decode pixel data with SimpleITK, in a file without the rescale and MONOCHROME1, which it would apply."""
    syntax = UID(header.text("TransferSyntaxUID"))
    if not syntax:
        raise InputError(
            f"{header.path}: has no TransferSyntaxUID, so its compressed pixels cannot be read; export it again"
        )
    size = tuple(header.integer(keyword) for keyword in SIZE)
    try:
        with tempfile.NamedTemporaryFile(prefix="virtual-phantom-", suffix=".dcm") as file:
            file.write(_bare_header(syntax, size) + START + encoded + END)
            file.flush()
            array = sitk.GetArrayFromImage(sitk.ReadImage(file.name, imageIO="GDCMImageIO"))
    except OSError as error:
        raise InputError(f"{header.path}: no space for temporary files ({error.strerror}); set TMPDIR") from None
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{header.path}: pixel data ({syntax.name}) cannot be decoded ({type(error).__name__}); is the file "
            "complete?"
        ) from None
    array = array.reshape(array.shape[-2:]) if array.ndim == 3 and array.shape[0] == 1 else array
    if array.shape != (header.integer("Rows"), header.integer("Columns")):
        raise InputError(
            f"{header.path}: its header says {header.integer('Rows')} x {header.integer('Columns')} pixels, its "
            f"compressed data hold {' x '.join(map(str, array.shape))}; is the file complete?"
        )
    return array


def _check_length(header: Slice) -> None:
    """Reject a header with more pixels than the file can contain, before memory is allocated."""
    syntax = UID(header.text("TransferSyntaxUID"))
    if syntax and not (syntax.is_valid and not syntax.is_private and syntax.is_transfer_syntax):
        raise InputError(f"{header.path}: TransferSyntaxUID is unknown; export it as Explicit VR Little Endian")
    rows, columns = header.integer("Rows"), header.integer("Columns")
    if syntax and syntax.is_encapsulated and syntax != DeflatedExplicitVRLittleEndian:
        return
    most = header.path.stat().st_size * (GZIP_MOST if syntax == DeflatedExplicitVRLittleEndian else 1)
    if rows * columns * header.integer("BitsAllocated") / 8 > most:
        _pixel_data(header)
        raise InputError(
            f"{header.path}: cannot be read as DICOM (its header says {rows} x {columns} pixels, which the file does "
            "not hold); is the file complete?"
        )
