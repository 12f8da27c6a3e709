"""A folder tree of DICOM CT series to a recording of images: one NIfTI file in HU, and one repeat, per series.

Converting leaves everything behind that is not the image or a fact about the scan: no patient data get into the
recording.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
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
from ...io.volumes import LARGEST_TILT, Volume, write_nifti
from ...phantom.dicom_files import Unused, files_in, folders_under, not_dicom, slices_of
from ...phantom.dicom_series import Series, read_slices, series_among
from ...phantom.masks import GRID_TOLERANCE_MM
from ...phantom.plausible import known_checks, require_plausible
from ..document import SCHEMA
from ..provenance import SHARED, check_shared, series_facts
from ..recording import Recording
from . import write_folder

NOMINAL = (*SHARED, "pitch", "tube_current_ma", "mas", "dose_mgy")
SCAN = ("source_to_isocentre_mm", "source_to_detector_mm")


@dataclass(frozen=True)
class Scan:
    """A series, the facts of its headers, and the checksums of its files."""

    series: Series
    facts: dict
    sha256: list[str]


def import_dicom_tree(
    root: str | Path,
    folder: str | Path,
    phantom: str | None = None,
    kernel: str | None = None,
    not_checked: Collection[str] = (),
) -> Recording:
    """Write a recording of images and load it. Repeats are numbered in the order of the folders' names.

    Parameters
    ----------
    root : str or Path
        Every series of CT slices in it and in the folders below is a repeat. Notes say which files are not used (other
        modalities, scouts, copies).
    folder : str or Path
        The recording's, which is made.
    phantom : str, optional
        What was scanned, for recording.yaml.
    kernel : str, optional
        Take only the series of this reconstruction kernel, as its DICOM header names it (Br38f/3 for [Br38f, 3]).
    not_checked : collection of str, optional
        Names of plausible.CHECKS to skip, here and whenever the recording is read.

    Raises
    ------
    InputError
        If there is no series, if one cannot be read (dicom_series.read_slices) or is no CT in HU, or if two differ in
        grid, kernel, tube voltage, slice thickness or scanner.
    """
    if not str(root):
        raise InputError("source: is empty; give a path (is a variable of the shell not set?)")
    root, target_folder = Path(root), Path(folder)
    if not root.is_dir():
        problem = f"is {not_dicom(root) or 'one DICOM file'}" if root.is_file() else "no such folder"
        raise InputError(f"{root}: {problem}; give the top of a tree of DICOM series")
    known_checks(not_checked)
    found = _find(root)
    chosen = [scan for scan in found if kernel is None or scan.facts.get("kernel") == kernel]
    if not chosen:
        have = ", ".join(sorted({str(scan.facts.get("kernel")) for scan in found}))
        raise InputError(f"{root}: holds no series of kernel {kernel}; there are: {have}")
    first = chosen[0]
    for scan in chosen[1:]:
        check_shared(scan.facts, first.facts, scan.series.name, first.series.name)
    names = [f"repeat{number:02d}.nii.gz" for number in range(1, len(chosen) + 1)]

    def write(target: Path) -> None:
        grid: Grid | None = None
        seen: dict[bytes, str] = {}
        for scan, name in zip(chosen, names, strict=True):
            own, image = scan.series.name, read_slices(scan.series)
            require_plausible(image.array, image.grid, own, not_checked)
            if grid is not None and not image.grid.matches(grid, GRID_TOLERANCE_MM):
                raise InputError(f"{own}: is on another grid ({image.grid}) than {first.series.name} ({grid})")
            if grid is not None and image.grid.rotated_against(grid) > LARGEST_TILT:
                raise InputError(f"{own}: is rotated against {first.series.name}; resample it onto the same grid")
            digest = hashlib.sha256(image.array).digest()
            if digest in seen:
                note(f"{own}: has the same voxels as {seen[digest]}; if it is a copy, it is no repeat: remove it")
            seen[digest], grid = own, image.grid
            write_nifti(_smallest_type(image), target / name)

    means = defaultdict(list)
    for scan in chosen:
        for key in (*NOMINAL, *SCAN):
            if key in scan.facts:
                means[key].append(scan.facts[key])
    typical = {key: values[0] if key in (*SHARED, *SCAN) else float(np.mean(values)) for key, values in means.items()}
    typical = _possible(typical, first.series.name)
    lengths = {key: typical[key] for key in SCAN if key in typical}
    content = {
        "kind": "images",
        **({"phantom": phantom} if phantom else {}),
        **({"scan": lengths} if lengths else {}),
        "nominal": {key: typical[key] for key in NOMINAL if key in typical},
        "origin": {"importer": "dicom", "sha256": [digest for scan in chosen for digest in scan.sha256]},
        **({"not_checked": list(not_checked)} if not_checked else {}),
        "repeats": names,
    }
    return write_folder(target_folder, content, write)


def _possible(facts: dict, name: str) -> dict:
    """The facts that recording.yaml can state. Scanners write 0 for what they do not know; the others are reported."""
    sections = read_schema(SCHEMA)["properties"]
    known = {key: sections["scan" if key in SCAN else "nominal"]["properties"][key] for key in facts}
    left_out = [key for key, value in facts.items() if not Draft202012Validator(known[key]).is_valid(value)]
    if left_out:
        values = ", ".join(f"{key} ({facts[key]})" for key in left_out)
        note(f"{name}: not kept, as no scan has this value: {values}")
    return {key: value for key, value in facts.items() if key not in left_out}


def _find(root: Path) -> list[Scan]:
    """Every series below a folder, in the order of their folders."""
    unused = Unused()
    slices = [one for folder in folders_under(root, unused) for one in slices_of(files_in(folder), unused)]
    if not slices:
        there = "; ".join(unused.lines(root))
        raise InputError(
            f"{root}: holds no CT slice in DICOM, and no folder under it does" + (f" ({there})" if there else "")
        )
    found, copies = [], {}
    for series in series_among(slices, unused, root):
        digests = sorted(sha256(one.path) for one in series.slices)
        if tuple(digests) in copies:
            note(f"{series.name}: not used: a copy of {copies[tuple(digests)]}")
            continue
        copies[tuple(digests)] = series.name
        found.append(Scan(series, series_facts(series), digests))
    unused.report(root)
    return found


def _smallest_type(image: Volume) -> Volume:
    """Whole HU as int16, which they were in DICOM; others stay float32."""
    whole = np.rint(image.array)
    limits = np.iinfo(np.int16)
    if np.array_equal(whole, image.array) and whole.min() >= limits.min and whole.max() <= limits.max:
        return Volume(whole.astype(np.int16), image.grid)
    return image
