"""Turn the stored values of a CT slice into HU, or refuse them.

pydicom reads the bytes and this module their bits. SimpleITK decodes compressed pixel data only: as a reader of whole
files, it inverts MONOCHROME1, which concerns the display alone (PS3.3, C.7.6.3.1.2).
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

START = b"\xe0\x7f\x10\x00OB\0\0\xff\xff\xff\xff"  # of the element of encapsulated pixel data
END = b"\xfe\xff\xdd\xe0\0\0\0\0"  # its delimiter
SIZE = ("Rows", "Columns", "SamplesPerPixel", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation")
# From here on, padding looks like tissue. Below is air, and what scanners write outside of the scanned circle.
TISSUE_HU = -900.0
WATER_TO_AIR_HU = 1000.0  # by the definition of the scale
# Scanners store HU - 1024 in 12 bits, or up to 30,710 HU in the extended scale (Siemens); more is no CT number.
HIGHEST_HU = 31_743.0  # 2^15 - 1 - 1024


def check_pixels(slices: Sequence[Slice], name: object) -> None:
    """Check, before pixels are read, that all slices are stored in one way that can be turned into HU.

    Parameters
    ----------
    name : object
        What messages about the whole series begin with.

    Raises
    ------
    InputError
        If an attribute is missing, has no meaning for CT, or differs between slices.
    """
    first = slices[0]
    for one in slices:
        _check(one)
        if one.whole("PixelRepresentation") != first.whole("PixelRepresentation"):
            raise InputError(
                f"{one.path}: PixelRepresentation differs from {first.path.name}, so one of them has the wrong sign; "
                "correct it"
            )
    _check_rescale(slices, name)
    _note(slices, name, "PhotometricInterpretation", ("MONOCHROME1",), "it concerns the display; values are as stored")
    _note(slices, name, "LossyImageCompression", ("01",), "values were changed by lossy compression")
    _note(slices, name, "BurnedInAnnotation", ("YES",), "there may be text in the image")
    for word in ("MPR", "AVERAGE", "REFORMATTED"):
        some = [one for one in slices if word in one.text("ImageType").split("/")]
        if some:
            note(f"{name}: ImageType is {word}: a reformatted image, whose noise is not the scanner's")


def _check_rescale(slices: Sequence[Slice], name: object) -> None:
    """Refuse a rescale that differs in a minority of slices; programs that scale slice by slice have no majority."""
    pairs = [(one.number("RescaleSlope"), one.number("RescaleIntercept")) for one in slices]
    (usual, count), *others = Counter(pairs).most_common()
    if not others:
        return
    odd = pairs.index(others[0][0])
    words = "RescaleSlope and RescaleIntercept"
    if count > len(slices) / 2:
        raise InputError(
            f"{slices[odd].path}: {words} are {pairs[odd][0]:g} and {pairs[odd][1]:g}, those of most slices "
            f"{usual[0]:g} and {usual[1]:g}; correct them"
        )
    note(f"{name}: {words} differ between slices; each slice is read with its own")


def _note(slices: Sequence[Slice], name: object, keyword: str, value: tuple[str, ...], meaning: str) -> None:
    count = sum(one.values.get(keyword) == value for one in slices)
    if count:
        note(f"{name}: {keyword} is {value[0]} in {count} of {len(slices)} slices: {meaning}")


def _check(one: Slice) -> None:
    if one.has("ModalityLUTSequence"):
        raise InputError(f"{one.path}: has a ModalityLUTSequence instead of RescaleSlope; export it with HU")
    if missing := [keyword for keyword in ("RescaleSlope", "RescaleIntercept") if not one.has(keyword)]:
        raise InputError(f"{one.path}: has no {' and '.join(missing)}, so its values cannot be turned into HU")
    slope, intercept = one.number("RescaleSlope"), one.number("RescaleIntercept")
    if not one.has("PhotometricInterpretation"):
        raise InputError(f"{one.path}: has no PhotometricInterpretation; export the series again")
    if one.text("PhotometricInterpretation") not in ("MONOCHROME1", "MONOCHROME2"):
        raise InputError(f"{one.path}: PhotometricInterpretation is not MONOCHROME1 or MONOCHROME2; correct it")
    if one.whole("SamplesPerPixel") != 1:
        raise InputError(f"{one.path}: SamplesPerPixel is {one.whole('SamplesPerPixel')}; a CT slice has 1")
    if one.whole("NumberOfFrames", 1) != 1:
        raise InputError(f"{one.path}: NumberOfFrames is {one.whole('NumberOfFrames')}; give one file per slice")
    allocated, stored, high = (one.whole(key) for key in ("BitsAllocated", "BitsStored", "HighBit"))
    if allocated not in (16, 32):
        raise InputError(f"{one.path}: BitsAllocated is {allocated}; CT slices have 16")
    if not 8 < stored <= allocated or high != stored - 1:
        raise InputError(
            f"{one.path}: BitsStored {stored} and HighBit {high} do not fit BitsAllocated {allocated}; correct them"
        )
    if abs(slope) * 2**stored < WATER_TO_AIR_HU:
        raise InputError(
            f"{one.path}: RescaleSlope is {slope:g}, so all values of {stored} bits lie within "
            f"{abs(slope) * 2**stored:.3g} HU, less than from air to water; correct it"
        )
    if one.whole("PixelRepresentation") not in (0, 1):
        raise InputError(f"{one.path}: PixelRepresentation is {one.whole('PixelRepresentation')}; it must be 0 or 1")
    _check_length(one)
    if one.has("RealWorldValueMappingSequence"):
        _check_mapping(one, slope, intercept)


def _check_mapping(one: Slice, slope: float, intercept: float) -> None:
    """Refuse slices whose real world values (PS3.3, C.7.6.16.2.11) are not HU, or not as the rescale gives them."""
    mappings = one.values["RealWorldValueMappingSequence"]
    if mappings is BROKEN:
        raise InputError(f"{one.path}: RealWorldValueMappingSequence is not readable; remove it if values are in HU")
    for mapping in mappings:
        unit, *numbers = mapping.split("|")
        if unit != HOUNSFIELD:
            raise InputError(f"{one.path}: RealWorldValueMappingSequence gives another unit than HU; give images in HU")
        try:
            same = np.allclose([float(number) for number in numbers], [slope, intercept], rtol=1e-6)
        except ValueError:
            same = False
        if not same:
            raise InputError(
                f"{one.path}: RealWorldValueMappingSequence and RescaleSlope disagree on HU; remove the wrong one"
            )


def read_into(slices: Sequence[Slice], array: np.ndarray, name: object) -> None:
    """Read the HU of all slices.

    Parameters
    ----------
    slices : sequence of Slice
        Checked by `check_pixels`.
    array : ndarray of float32, shape (slices, rows, columns)
        Filled.
    name : object
        What notes begin with.

    Raises
    ------
    InputError
        If pixel data are missing, damaged, of another size than the header says, or not in HU.
    """
    padded = 0
    for one, target in zip(slices, array, strict=True):
        stored, padding = _stored(one), _padding(one)
        scaled = stored * np.float64(one.number("RescaleSlope"))
        scaled += one.number("RescaleIntercept")
        target[:] = scaled
        if padding is not None:
            outside = _outside(stored, padding, scaled)
            target[outside] = HU_AIR
            padded += np.count_nonzero(outside)
        if (highest := float(target.max())) > HIGHEST_HU:
            raise InputError(
                f"{one.path}: values reach {highest:.0f} HU, which no CT has; is PixelRepresentation (signed or not) "
                "or RescaleSlope wrong?"
            )
    if padded:
        note(
            f"{name}: {padded} voxels at the border of the slices have PixelPaddingValue, which would be tissue in HU; "
            "they are read as air"
        )


def same_pixels(one: Slice, other: Slice) -> bool:
    """True if two slices have the same values in HU."""
    hu = [_stored(each) * each.number("RescaleSlope") + each.number("RescaleIntercept") for each in (one, other)]
    return np.array_equal(*hu)


def _outside(stored: np.ndarray, padding: tuple[int, int], hu: np.ndarray) -> np.ndarray:
    """The pixels with the padding value, if it looks like tissue or metal, and are connected to the border."""
    # Tissue may have the same value by chance, so what lies within the body is left as it is.
    mask = (stored >= padding[0]) & (stored <= padding[1])
    if not mask.any() or hu[mask].max() < TISSUE_HU:
        return np.zeros_like(mask)
    labels, _ = ndimage.label(mask)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    return np.isin(labels, border[border > 0])


def _stored(one: Slice) -> np.ndarray:
    """Stored values of a slice, in 64 bits, so that no arithmetic wraps."""
    element, little = _pixel_data(one)
    rows, columns = one.whole("Rows"), one.whole("Columns")
    allocated, signed = one.whole("BitsAllocated"), one.whole("PixelRepresentation") == 1
    if getattr(element, "length", 0) == UNDEFINED_LENGTH:
        return _decompressed(one, element.value).astype(np.int64)
    kind = np.dtype(f"{'<' if little else '>'}{'i' if signed else 'u'}{allocated // 8}")
    needed, there = rows * columns * kind.itemsize, len(element.value)
    # Writers pad with zeros, to an even length or, rarely, by a row.
    padded = needed <= there < needed + 2 * columns * kind.itemsize and not any(element.value[needed:])
    if not padded:
        raise InputError(
            f"{one.path}: its header says {rows} x {columns} pixels, which the file does not hold ({there} bytes of "
            f"PixelData, {needed} are needed); is the file complete?"
        )
    raw = np.frombuffer(element.value, kind, rows * columns).reshape(rows, columns)
    return _trimmed(one, raw.astype(np.int64))


def _pixel_data(one: Slice) -> tuple[RawDataElement, bool]:
    """The element with the pixels, and whether its bytes are little-endian."""
    try:
        with disable_value_validation():
            dataset = pydicom.dcmread(one.path, force=True, specific_tags=["PixelData"])
            element = dataset.get_item("PixelData")
    except Exception as error:  # of many types; its words may quote the header
        raise InputError(
            f"{one.path}: cannot be read as DICOM ({type(error).__name__}); is the file complete?"
        ) from None
    if element is None or not element.value:
        raise InputError(f"{one.path}: has no PixelData; is the file complete?")
    return element, dataset.original_encoding[1] is not False


def _trimmed(one: Slice, raw: np.ndarray) -> np.ndarray:
    """The values of the stored bits alone: bits above them may contain an overlay (retired, but archives have it)."""
    stored, signed = one.whole("BitsStored"), one.whole("PixelRepresentation")
    if stored == one.whole("BitsAllocated"):
        return raw
    low, top = (-(1 << stored - 1), (1 << stored - 1) - 1) if signed else (0, (1 << stored) - 1)
    beyond = (raw < low) | (raw > top)
    if not beyond.any():
        return raw
    if one.has(OVERLAY):
        kept = raw & (1 << stored) - 1
        return np.where(kept > top, kept - (1 << stored), kept)
    if (padding := _padding(one)) is not None:
        beyond &= (raw < padding[0]) | (raw > padding[1])
    if beyond.any():
        raise InputError(
            f"{one.path}: has values beyond its {stored} bits stored, so BitsStored or PixelRepresentation is wrong; "
            "correct it"
        )
    return raw


def _padding(one: Slice) -> tuple[int, int] | None:
    """The range of values that mark missing pixels, in the sign of the pixels; None if there is none."""
    if not one.has("PixelPaddingValue"):
        return None
    bits, signed, ends = one.whole("BitsAllocated"), one.whole("PixelRepresentation"), []
    for keyword in ("PixelPaddingValue", "PixelPaddingRangeLimit"):
        value = one.whole(keyword, ends[0] if ends else None)
        # The attribute is written as US or SS, not always as PixelRepresentation says.
        value %= 1 << bits if value >= 0 or bits == 32 else 1 << 16
        ends.append(value - (1 << bits) if signed and value >= 1 << bits - 1 else value)
    return min(ends), max(ends)


@functools.lru_cache(maxsize=4)
def _bare_header(syntax: str, size: tuple[int, ...]) -> bytes:
    """A DICOM file with nothing but what a decoder needs, up to the pixel data; `size` has the values of SIZE."""
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


def _decompressed(one: Slice, encoded: bytes) -> np.ndarray:
    """Decode pixel data with SimpleITK."""
    # It reads a file with these pixel data alone: no rescale and no MONOCHROME1, which it would apply.
    syntax = UID(one.text("TransferSyntaxUID"))
    if not syntax:
        raise InputError(
            f"{one.path}: has no TransferSyntaxUID, so its compressed pixels cannot be read; export it again"
        )
    size = tuple(one.whole(keyword) for keyword in SIZE)
    try:
        with tempfile.NamedTemporaryFile(prefix="virtual-phantom-", suffix=".dcm") as file:
            file.write(_bare_header(syntax, size) + START + encoded + END)
            file.flush()
            array = sitk.GetArrayFromImage(sitk.ReadImage(file.name, imageIO="GDCMImageIO"))
    except OSError as error:
        raise InputError(f"{one.path}: no room for temporary files ({error.strerror}); set TMPDIR") from None
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{one.path}: pixel data ({syntax.name}) cannot be decoded ({type(error).__name__}); is the file complete?"
        ) from None
    array = array.reshape(array.shape[-2:]) if array.ndim == 3 and array.shape[0] == 1 else array
    if array.shape != (one.whole("Rows"), one.whole("Columns")):
        raise InputError(
            f"{one.path}: its header says {one.whole('Rows')} x {one.whole('Columns')} pixels, its compressed data "
            f"hold {' x '.join(map(str, array.shape))}; is the file complete?"
        )
    return array


def _check_length(one: Slice) -> None:
    """Refuse a header that says more pixels than the file can contain, before memory is taken for them."""
    syntax = UID(one.text("TransferSyntaxUID"))
    if syntax and not (syntax.is_valid and not syntax.is_private and syntax.is_transfer_syntax):
        raise InputError(f"{one.path}: TransferSyntaxUID is no known one; export it as Explicit VR Little Endian")
    rows, columns = one.whole("Rows"), one.whole("Columns")
    if syntax and syntax.is_encapsulated and syntax != DeflatedExplicitVRLittleEndian:
        return
    most = one.path.stat().st_size * (GZIP_MOST if syntax == DeflatedExplicitVRLittleEndian else 1)
    if rows * columns * one.whole("BitsAllocated") / 8 > most:
        _pixel_data(one)
        raise InputError(
            f"{one.path}: cannot be read as DICOM (its header says {rows} x {columns} pixels, which the file does not "
            "hold); is the file complete?"
        )
