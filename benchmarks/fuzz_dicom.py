"""Count how often a damaged DICOM header is rejected, reported, read correctly or misread (minutes).

Each run damages one to three attributes of a small CT: missing, empty, of a wrong type, or inconsistent in one slice.
It reads the CT as a phantom and imports it as a recording, and compares both with the undamaged CT. A change of more
than 1 HU or one voxel without a note, and any exception but InputError, are faults: they are listed, and the exit
status is 1.
"""

import contextlib
import shutil
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom
from pydicom.dataelem import RawDataElement
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

from virtual_phantom.base.console import collected_notes
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom.ct import read_hu
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree

REFUSED, SAME, NOTED = "refused", "read the same", "read the same, with a note"
CHANGED_WITH_NOTE = "changed, with a note"
CHANGED, CRASHED = "CHANGED IN SILENCE", "CRASHED"
FAULTS = (CHANGED, CRASHED)
LARGEST_HU = 1.0

ATTRIBUTES = """SOPClassUID SOPInstanceUID SeriesInstanceUID StudyInstanceUID FrameOfReferenceUID Modality ImageType
SeriesNumber AcquisitionNumber InstanceNumber ImagePositionPatient ImageOrientationPatient PixelSpacing SliceThickness
SliceLocation SpacingBetweenSlices Rows Columns SamplesPerPixel PhotometricInterpretation BitsAllocated BitsStored
HighBit PixelRepresentation RescaleSlope RescaleIntercept RescaleType PixelPaddingValue WindowCenter WindowWidth
NumberOfFrames GantryDetectorTilt KVP ConvolutionKernel Manufacturer ManufacturerModelName XRayTubeCurrent Exposure
CTDIvol PatientPosition LossyImageCompression SpecificCharacterSet PixelData""".split()
KINDS = ("missing", "empty", "wrong type", "inconsistent")
ODD_TEXTS = (
    *("0", "-1", "1e400", "nan", "a", "x" * 70, "1\\2", "1\\2\\3", "\x00", "4,0"),
    *(" ", "1e-30", "65535", "\xff\xfe"),
)
OTHER_VALUES = {
    "SOPClassUID": ["1.2.840.10008.5.1.4.1.1.4", "1.2.840.10008.5.1.4.1.1.2.1", "1.2.840.10008.5.1.4.1.1.7", "1.2.3"],
    "ImageType": [["ORIGINAL", "PRIMARY", "LOCALIZER"], ["DERIVED", "SECONDARY", "AXIAL", "IODINE"], ["DERIVED"]],
    "Modality": ["MR", "OT", "PT", "CR"],
    "PhotometricInterpretation": ["MONOCHROME1", "RGB", "PALETTE COLOR", "YBR_FULL"],
    "ImageOrientationPatient": [
        [1, 0, 0, 0, 0, -1],
        [0, 1, 0, 1, 0, 0],
        [1, 0, 0, 0, 0.999, 0.0447],
        [-1, 0, 0, 0, -1, 0],
    ],
    "RescaleType": ["MGML", "HU_MOD", "US", "PCT", "Z_EFF"],
    "PatientPosition": ["FFS", "HFP"],
    "ConvolutionKernel": ["B70f", ["Br38f", "3"]],
    "SpecificCharacterSet": ["ISO_IR 192", "GB18030", "nonsense"],
    "LossyImageCompression": ["01"],
}


@dataclass(frozen=True)
class Result:
    """Outcome of one run, with the text of the error, note or difference."""

    outcome: str
    words: str
    damage: str


def compared(read: Callable[[], Volume], undamaged: Volume, damage: str) -> Result:
    """Read once, and compare with the undamaged volume."""
    try:
        with warnings.catch_warnings(), collected_notes() as notes:
            warnings.simplefilter("ignore")
            volume = read()
    except InputError as error:
        text = str(error)
        return Result(REFUSED if text.isprintable() and len(text) < 2000 else CRASHED, text, damage)
    except Exception:
        return Result(CRASHED, traceback.format_exc(), damage)
    words = "; ".join(notes)
    if difference := differs(volume, undamaged):
        return Result(CHANGED_WITH_NOTE if words else CHANGED, f"{difference}. {words}", damage)
    return Result(NOTED if words else SAME, words, damage)


def differs(volume: Volume, other: Volume) -> str:
    """Difference of more than one voxel or LARGEST_HU in words; empty if there is none."""
    if volume.grid.shape != other.grid.shape:
        return f"{volume.grid} instead of {other.grid}"
    for corner in ([0, 0, 0, 1], [*(n - 1 for n in other.grid.shape[::-1]), 1]):
        moved = np.abs(volume.grid.affine @ corner - other.grid.affine @ corner)[:3]
        if (moved > other.grid.spacing[::-1]).any():
            return f"moved by {moved.max():.3g} mm"
    away = float(np.abs(volume.array - other.array).max())
    return f"{away:.3g} HU" if away > LARGEST_HU else ""


def run_dicom(runs: int, seed: int, scratch: Path) -> Iterator[tuple[str, Result]]:
    """Yield the reader and the outcome for damaged DICOM series."""
    random = np.random.default_rng(seed)
    slices = series()
    whole = scratch / "whole"
    write(slices, whole)
    undamaged = read_hu(whole)
    pairs = [(attribute, kind) for attribute in ATTRIBUTES for kind in KINDS]
    random.shuffle(pairs)
    for number in range(runs):
        folder = scratch / "series"
        shutil.rmtree(folder, ignore_errors=True)
        damaged = [pydicom.dcmread(path) for path in sorted(whole.iterdir())]
        # Each attribute and kind once, then combinations.
        chosen = [pairs[number]] if number < len(pairs) else []
        while not chosen or (number >= len(pairs) and len(chosen) < 3 and random.random() < 0.5):
            chosen.append(pairs[random.integers(len(pairs))])
        damage = "; ".join(spoil(damaged, attribute, kind, random) for attribute, kind in chosen)
        try:
            write(damaged, folder)
        except Exception:  # pydicom cannot write every damage, such as a length that the value contradicts
            continue
        yield "read_hu", compared(lambda folder=folder: read_hu(folder), undamaged, damage)

        def imported(folder: Path = folder) -> Volume:
            recording = scratch / "recording"
            shutil.rmtree(recording, ignore_errors=True)
            return next(iter(import_dicom_tree(folder, recording).repeats))

        yield "import", compared(imported, undamaged, damage)


def series() -> list[pydicom.Dataset]:
    """Six slices of a water cylinder with a rod, off center, without noise."""
    y, x = np.mgrid[:24, :30]
    slices = []
    for k in range(6):
        hu = np.where(np.hypot(x - 15, y - 12) < 10, 20 * k, -1000)
        hu[5:9, 10:14] = 200
        one = pydicom.Dataset()
        one.file_meta = pydicom.dataset.FileMetaDataset()
        one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        one.SOPClassUID, one.SOPInstanceUID = CTImageStorage, f"1.2.3.{k + 1}"
        one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID
        one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID
        one.StudyInstanceUID, one.SeriesInstanceUID, one.FrameOfReferenceUID = "1.2.4", "1.2.5", "1.2.6"
        one.Modality, one.ImageType = "CT", ["ORIGINAL", "PRIMARY", "AXIAL"]
        one.PatientName, one.PatientPosition = "A^B", "HFS"
        one.SeriesNumber, one.AcquisitionNumber, one.InstanceNumber = 1, 1, k + 1
        one.ImagePositionPatient, one.ImageOrientationPatient = [-30, -20, 10 + 3 * k], [1, 0, 0, 0, 1, 0]
        one.PixelSpacing, one.SliceThickness, one.SliceLocation, one.SpacingBetweenSlices = [4, 4], 3, 10 + 3 * k, 3
        one.Rows, one.Columns, one.SamplesPerPixel, one.PhotometricInterpretation = 24, 30, 1, "MONOCHROME2"
        one.BitsAllocated, one.BitsStored, one.HighBit, one.PixelRepresentation = 16, 16, 15, 1
        one.RescaleSlope, one.RescaleIntercept, one.RescaleType, one.NumberOfFrames = 1, -1024, "HU", 1
        one.add_new("PixelPaddingValue", "SS", -2000)
        one.WindowCenter, one.WindowWidth, one.GantryDetectorTilt, one.KVP = 40, 400, 0, 120
        one.ConvolutionKernel, one.Manufacturer, one.ManufacturerModelName = "B30f", "Maker", "Model"
        one.XRayTubeCurrent, one.Exposure, one.CTDIvol, one.LossyImageCompression = 100, 50, 5.0, "00"
        one.SpecificCharacterSet = "ISO_IR 100"
        one.PixelData = (hu + 1024).astype("<i2").tobytes()
        slices.append(one)
    return slices


def write(slices: list[pydicom.Dataset], folder: Path) -> None:
    """Write slices without any check of their attributes."""
    folder.mkdir()
    for number, one in enumerate(slices):
        with pydicom.config.disable_value_validation(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            one.preamble = bytes(128)
            one.save_as(folder / f"{number}.dcm")


def spoil(slices: list[pydicom.Dataset], attribute: str, kind: str, random: np.random.Generator) -> str:
    """Damage one attribute in one slice, or in all if it is not by inconsistency. Returns what was done."""
    tag = pydicom.tag.Tag(attribute)
    place = random.integers(len(slices))
    some = [slices[place]] if kind == "inconsistent" or random.random() < 0.5 else slices
    vr = pydicom.datadict.dictionary_VR(tag)[:2]
    words = ODD_TEXTS[random.integers(len(ODD_TEXTS))].encode("latin-1")
    if random.random() < 0.3:
        vr = ("LO", "DS", "US", "FD", "UN", "OB")[random.integers(6)]
    drawn = int(random.integers(1 << 30))
    value = b""
    for one in some:
        if kind == "missing":
            if tag in one:
                del one[tag]
        elif kind == "empty":
            one[tag] = RawDataElement(tag, vr, 0, b"", 0, False, True)
        elif kind == "wrong type":
            value = words + b" " * (len(words) % 2)
            one[tag] = RawDataElement(tag, vr, len(value), value, 0, False, True)
        else:
            # An attribute that an earlier damage has left with another type takes no such value.
            expected = (TypeError, ValueError, pydicom.errors.BytesLengthException)
            with pydicom.config.disable_value_validation(), contextlib.suppress(*expected):
                value = _other(one, attribute, np.random.default_rng(drawn))
                if tag in one:
                    one[tag].value = value
    return f"{attribute} {kind} {str(value)[:60]} as {vr} in {'all slices' if len(some) > 1 else f'slice {place}'}"


def _other(one: pydicom.Dataset, attribute: str, random: np.random.Generator) -> object:
    if attribute in OTHER_VALUES:
        return OTHER_VALUES[attribute][random.integers(len(OTHER_VALUES[attribute]))]
    if attribute == "PixelData":
        return one.PixelData[: 2 * random.integers(len(one.PixelData) // 2)]
    value = one.get(attribute)
    if attribute.endswith("UID"):
        return f"{value}.7"
    if isinstance(value, str):
        return "OTHER"
    if attribute in ("Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "SamplesPerPixel", "NumberOfFrames"):
        return max(0, int(value) + int(random.choice([-8, -1, 1, 8, 16])))
    if attribute == "PixelRepresentation":
        return 1 - int(value)
    factors = np.array([0, -1, 0.5, 1.001, 1.1, 2, 10])
    if isinstance(value, list | pydicom.multival.MultiValue):
        changed = [float(number) for number in value]
        index = random.integers(len(changed))
        changed[index] = round(changed[index] * random.choice(factors) + random.choice([0, 0.005, 1, 100]), 6)
        return changed
    changed = round(float(value) * random.choice(factors) + random.choice([0, 0.3, 1]), 6)
    return changed if attribute not in ("PixelPaddingValue", "SeriesNumber") else int(changed)


def add_arguments(parser):
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", help="list the runs with this outcome")


def run(options):
    counts: Counter = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        for reader, result in run_dicom(options.runs, options.seed, Path(scratch)):
            counts[reader, result.outcome] += 1
            if result.outcome in FAULTS or result.outcome == options.show:
                print(f"{reader}: {result.damage}: {result.outcome}: {result.words.replace(scratch, '')}")
    for (reader, outcome), count in sorted(counts.items()):
        print(f"{reader:8} {outcome:28} {count:6}")
    return int(any(outcome in FAULTS for _, outcome in counts))
