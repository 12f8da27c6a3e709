"""Import of a folder tree of DICOM CT series as a recording of images: one repeat, a NIfTI file in HU, per series.

Only images and facts about the scan are copied: no patient data get into the recording.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jsonschema import Draft202012Validator

from ...base.console import note
from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.files import sha256
from ...io.schema import read_schema
from ...io.volumes import Volume, write_nifti
from ...phantom.dicom_files import UnusedFiles, files_in, not_dicom, slices_of, walk_folders
from ...phantom.dicom_series import Series, read_slices, series_among
from ...phantom.plausibility import require_known_checks, require_plausible
from ..document import SCHEMA
from ..images import grid_mismatch
from ..provenance import SHARED, check_shared, series_facts
from ..recording import Recording
from . import write_folder

NOMINAL = (*SHARED, "pitch", "tube_current_ma", "mas", "dose_mgy")
SCAN = ("source_to_isocentre_mm", "source_to_detector_mm")


@dataclass(frozen=True)
class ImportedSeries:
    """A series, facts from its headers, and checksums of its files."""

    series: Series
    facts: dict
    sha256: list[str]


def import_dicom_tree(
    root: str | Path,
    folder: str | Path,
    phantom: str | None = None,
    kernel: str | None = None,
    not_checked: Collection[str] = (),
    one_slice: bool = False,
) -> Recording:
    """Write a recording of images and load it. Repeats are numbered in the order of their folder names.

    Parameters
    ----------
    root : str or Path
        Every series of CT slices in this folder and below becomes a repeat. Notes list unused files (other modalities,
        scouts, copies).
    kernel : str, optional
        Import only series with this reconstruction kernel, as in the DICOM header (Br38f/3 for [Br38f, 3]).
    not_checked : collection of str, optional
        Names of plausibility.CHECKS to skip, now and whenever the recording is loaded.
    one_slice : bool, optional
        Whether a series may have a single slice.

    Raises
    ------
    InputError
        If there is no series, or one cannot be read (dicom_series.read_slices) or is not a CT in HU. If two series
        differ in grid, kernel, tube voltage, slice thickness or scanner.
    """
    if not str(root):
        raise InputError("source: is empty; give a path (a shell variable may be unset)")
    root, target_folder = Path(root), Path(folder)
    if not root.is_dir():
        problem = f"is {not_dicom(root) or 'one DICOM file'}" if root.is_file() else "no such folder"
        raise InputError(f"{root}: {problem}; use the top folder of a tree of DICOM series")
    require_known_checks(not_checked)
    found = _find(root)
    chosen = [entry for entry in found if kernel is None or entry.facts.get("kernel") == kernel]
    if not chosen:
        kernels = ", ".join(sorted({str(entry.facts.get("kernel")) for entry in found}))
        raise InputError(f"{root}: has no series with kernel {kernel}; choose from {kernels}")
    first = chosen[0]
    for entry in chosen[1:]:
        check_shared(entry.facts, first.facts, entry.series.name, first.series.name)
    names = [f"repeat{number:02d}.nii.gz" for number in range(1, len(chosen) + 1)]

    def write(target: Path) -> None:
        grid: Grid | None = None
        seen: dict[bytes, str] = {}
        for entry, name in zip(chosen, names, strict=True):
            label, image = entry.series.name, read_slices(entry.series, one_slice)
            require_plausible(image.array, image.grid, label, not_checked)
            if grid is not None and (mismatch := grid_mismatch(image.grid, grid, label, first.series.name)):
                raise InputError(mismatch)
            digest = hashlib.sha256(image.array).digest()
            if digest in seen:
                note(f"{label}: has the same voxels as {seen[digest]}; if it is a copy, remove it")
            seen[digest], grid = label, image.grid
            write_nifti(_smallest_type(image), target / name)

    facts = {key: [entry.facts[key] for entry in chosen if key in entry.facts] for key in (*NOMINAL, *SCAN)}
    typical = {
        key: values[0] if key in (*SHARED, *SCAN) else float(np.mean(values)) for key, values in facts.items() if values
    }
    typical = _valid_facts(typical, first.series.name)
    lengths = {key: typical[key] for key in SCAN if key in typical}
    content = {
        **({"scan": lengths} if lengths else {}),
        "nominal": {key: typical[key] for key in NOMINAL if key in typical},
        "origin": {"importer": "dicom", "sha256": [digest for entry in chosen for digest in entry.sha256]},
        **({"not_checked": list(not_checked)} if not_checked else {}),
        "repeats": names,
    }
    return write_folder(target_folder, "images", phantom, content, write)


def _valid_facts(facts: dict, name: str) -> dict:
    """Return the facts that recording.yaml accepts, and report the others. Scanners write 0 for unknown values."""
    sections = read_schema(SCHEMA)["properties"]
    known = {key: sections["scan" if key in SCAN else "nominal"]["properties"][key] for key in facts}
    invalid = [key for key, value in facts.items() if not Draft202012Validator(known[key]).is_valid(value)]
    if invalid:
        values = ", ".join(f"{key} ({facts[key]})" for key in invalid)
        note(f"{name}: impossible values of the DICOM headers are omitted: {values}")
    return {key: value for key, value in facts.items() if key not in invalid}


def _find(root: Path) -> list[ImportedSeries]:
    """Return every series below a folder, in the order of the folders."""
    unused = UnusedFiles()
    slices = [part for folder in walk_folders(root, unused) for part in slices_of(files_in(folder), unused)]
    if not slices:
        details = "; ".join(unused.lines(root))
        raise InputError(
            f"{root}: has no CT slices in DICOM, here or in folders below{f' ({details})' if details else ''}; use the "
            "top folder of a tree of DICOM series"
        )
    found, copies = [], {}
    for series in series_among(slices, unused, root):
        digests = sorted(sha256(part.path) for part in series.slices)
        if tuple(digests) in copies:
            note(f"{series.name}: not used: copy of {copies[tuple(digests)]}")
            continue
        copies[tuple(digests)] = series.name
        found.append(ImportedSeries(series, series_facts(series), digests))
    unused.report(root)
    return found


def _smallest_type(image: Volume) -> Volume:
    """Convert whole HU to int16, as in DICOM; other values stay float32."""
    whole = np.rint(image.array)
    limits = np.iinfo(np.int16)
    if np.array_equal(whole, image.array) and whole.min() >= limits.min and whole.max() <= limits.max:
        return Volume(whole.astype(np.int16), image.grid)
    return image
