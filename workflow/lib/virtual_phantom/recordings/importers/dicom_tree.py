"""A folder tree of DICOM CT series to a recording of images: one NIfTI file in HU, and one repeat, per series.

Converting leaves everything behind that is not the image or a fact about the scan: no patient data get into the
recording.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom

from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.files import files_of, sha256
from ...io.volumes import Volume, write_nifti
from ...phantom.dicom_series import read_series
from ...phantom.masks import GRID_TOLERANCE_MM
from ..provenance import SHARED, check_shared, dicom_facts
from ..recording import Recording
from . import write_folder

NOMINAL = (*SHARED, "pitch", "tube_current_ma", "mas", "dose_mgy")
SCAN = ("source_to_isocentre_mm", "source_to_detector_mm")


@dataclass(frozen=True)
class Series:
    """A folder with one series, the facts of its headers, and the checksums of its files."""

    folder: Path
    facts: dict
    sha256: list[str]


def import_dicom_tree(
    root: str | Path, folder: str | Path, phantom: str | None = None, kernel: str | None = None
) -> Recording:
    """Write a recording of images and load it. Repeats are numbered in the order of the folders' names.

    Parameters
    ----------
    root : str or Path
        Every folder under it (or itself) that holds CT slices is one series, as archives lay them out; folders of other
        modalities (SEG, RTSTRUCT) are passed over.
    folder : str or Path
        The recording's, which is made.
    phantom : str, optional
        What was scanned, for recording.yaml.
    kernel : str, optional
        Take only the series of this reconstruction kernel, as its DICOM header names it (Br38f/3 for [Br38f, 3]).

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        If there is no series, if one cannot be read (dicom_series.read_series), or if two differ in grid, kernel, tube
        voltage, slice thickness or scanner.
    """
    root, target_folder = Path(root), Path(folder)
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; give the top of a tree of DICOM series")
    found = _find(root)
    chosen = [series for series in found if kernel is None or series.facts.get("kernel") == kernel]
    if not chosen:
        have = ", ".join(sorted({str(series.facts.get("kernel")) for series in found}))
        raise InputError(f"{root}: holds no series of kernel {kernel}; there are: {have}")
    first = chosen[0]
    for series in chosen[1:]:
        check_shared(series.facts, first.facts, series.folder, first.folder)
    names = [f"repeat{number:02d}.nii.gz" for number in range(1, len(chosen) + 1)]

    def write(target: Path) -> None:
        grid: Grid | None = None
        for series, name in zip(chosen, names, strict=True):
            image = read_series(series.folder)
            if grid is not None and not image.grid.matches(grid, GRID_TOLERANCE_MM):
                raise InputError(f"{series.folder}: is on another grid ({image.grid}) than {first.folder} ({grid})")
            grid = image.grid
            write_nifti(_smallest_type(image), target / name)

    means = defaultdict(list)
    for series in chosen:
        for key in (*NOMINAL, *SCAN):
            if key in series.facts:
                means[key].append(series.facts[key])
    typical = {key: values[0] if key in (*SHARED, *SCAN) else float(np.mean(values)) for key, values in means.items()}
    scan = {key: typical[key] for key in SCAN if key in typical}
    content = {
        "kind": "images",
        **({"phantom": phantom} if phantom else {}),
        **({"scan": scan} if scan else {}),
        "nominal": {key: typical[key] for key in NOMINAL if key in typical},
        "origin": {"importer": "dicom", "sha256": [digest for series in chosen for digest in series.sha256]},
        "repeats": names,
    }
    return write_folder(target_folder, content, write)


def _find(root: Path) -> list[Series]:
    """Every folder whose first DICOM file is a CT slice, in the order of their paths."""
    found = []
    for folder in (root, *sorted(path for path in root.rglob("*") if path.is_dir())):
        files = [path for path in files_of(folder) if _is_dicom(path)]
        if files and _modality(files[0]) == "CT":
            found.append(Series(folder, dicom_facts(folder), sorted(map(sha256, files))))
    if not found:
        raise InputError(f"{root}: holds no CT slice in DICOM, and no folder under it does")
    return found


def _is_dicom(path: Path) -> bool:
    """True if the file has DICOM's mark behind its preamble (PS3.10, 7.1)."""
    with path.open("rb") as file:
        return file.read(132)[128:] == b"DICM"


def _modality(path: Path) -> str:
    try:
        return str(pydicom.dcmread(path, specific_tags=["Modality"], stop_before_pixels=True).get("Modality"))
    except Exception as error:  # of many types; its words may quote the header
        raise InputError(f"{path}: cannot be read as DICOM ({type(error).__name__}); is the file complete?") from None


def _smallest_type(image: Volume) -> Volume:
    """Whole HU as int16, which they were in DICOM; others stay float32."""
    whole = np.rint(image.array)
    limits = np.iinfo(np.int16)
    if np.array_equal(whole, image.array) and whole.min() >= limits.min and whole.max() <= limits.max:
        return Volume(whole.astype(np.int16), image.grid)
    return image
