"""Scans brought here: fetched from the public bucket by s5cmd, or linked to where somebody has them already.

Both make the same folder: ct/ with the slices, seg/ with the regions, and SOURCE, which says whose they are.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from shlex import quote

from ...base.errors import InputError
from .files import check_series, instances
from .table import COLLECTIONS, MB, SOURCE, PublicScan

PROGRAM = "s5cmd"
PARTIAL = ".partial-"  # before the name of a scan that is not here whole
WORKERS = 16  # files at a time
RETRIES = 5  # of a request, by s5cmd itself, which waits longer each time
SHOWN = 160  # characters of what s5cmd says


def program() -> str:
    """Where s5cmd lies: on the path, or beside this Python.

    Raises
    ------
    InputError
        If it is in neither place.
    """
    found = shutil.which(PROGRAM) or shutil.which(PROGRAM, path=str(Path(sys.executable).parent))
    if found is None:
        raise InputError(
            f"{PROGRAM}: is not installed, and brings the scans; run make setup-fetch, or name a folder that has them "
            "under downloads.scans"
        )
    return found


def manifest(scan: PublicScan, folder: Path, bucket: str) -> str:
    """What s5cmd is to do: a line for each series. Files that are here with their size are passed over."""
    lines = []
    for series in scan.series:
        source, target = f"s3://{bucket}/{series.folder}/*", f"{folder / series.modality.lower()}/"
        lines.append(f"cp --if-size-differ {quote(source)} {quote(target)}\n")
    return "".join(lines)


def fetch_scan(scan: PublicScan, target: str | Path, endpoint: str, bucket: str) -> None:
    """Bring one scan. The folder appears when all of it is there and is what the list says.

    Parameters
    ----------
    target : str or Path
        The folder that is made.
    endpoint : str
        Address of the S3 service.

    Raises
    ------
    InputError
        If s5cmd is missing or fails, the disk has too little room, or what came is not what the list says. What came
        stays beside the target, and the next run goes on from there.
    """
    target = Path(target)
    partial = target.with_name(PARTIAL + target.name)
    run = program()
    partial.mkdir(parents=True, exist_ok=True)
    _drop_halves(partial)
    here = sum(path.stat().st_size for path in partial.rglob("*") if path.is_file())
    needed, free = scan.megabytes * MB - here, shutil.disk_usage(partial).free
    if needed > free:
        raise InputError(f"{target}: needs {needed / MB:.0f} MB, and {free / MB:.0f} are free; make room and run again")
    options = ["--no-sign-request", "--endpoint-url", endpoint, "--log", "error"]
    options += ["--numworkers", str(WORKERS), "--retry-count", str(RETRIES)]
    process = subprocess.run(
        [run, *options, "run"], input=manifest(scan, partial, bucket), capture_output=True, text=True, check_scan=False
    )
    if process.returncode:
        whole = sum(path.suffix == ".dcm" for path in partial.rglob("*"))
        raise InputError(
            f"{target}: {whole} of {scan.files} files came ({_reason(process.stderr)}); run again, and it goes on; or "
            "correct downloads.endpoint and downloads.bucket"
        )
    check_scan(scan, partial, f"delete {partial} and run again")
    _write_source(scan, partial, {series.modality: f"s3://{bucket}/{series.folder}" for series in scan.series})
    os.replace(partial, target)


def _drop_halves(partial: Path) -> None:
    """Files that s5cmd was writing when it was killed: their names have digits behind .dcm."""
    for path in partial.rglob("*"):
        if path.is_file() and path.suffix != ".dcm":
            path.unlink()


def _reason(said: str) -> str:
    """The first error of s5cmd, without the command that it repeats."""
    lines = said.split("\n")
    line = next((line for line in lines if line.startswith("ERROR")), lines[0] or "no reason given")
    if "send request failed" in line:
        return "no connection"
    return line.rpartition('": ')[2].partition(", request id")[0].removeprefix("ERROR ")[:SHOWN]


def link_scan(scan: PublicScan, files: Mapping[str, Iterable[Path]], target: str | Path) -> None:
    """Make the folder of a scan of links to files that lie elsewhere.

    Parameters
    ----------
    files : mapping of str to iterable of Path
        {modality: files}, as files.found_scans gives them.
    target : str or Path
        The folder that is made.
    """
    target = Path(target)
    partial = target.with_name(PARTIAL + target.name)
    shutil.rmtree(partial, ignore_errors=True)
    for modality, paths in files.items():
        folder = partial / modality.lower()
        folder.mkdir(parents=True)
        for number, path in enumerate(paths, start=1):
            (folder / f"{number:04d}.dcm").symlink_to(path.resolve())
    _write_source(scan, partial, {modality: str(list(paths)[0].resolve().parent) for modality, paths in files.items()})
    os.replace(partial, target)


def check_scan(scan: PublicScan, folder: str | Path, advice: str | None = None, sizes: bool = True) -> None:
    """Check that a folder that `fetch` or `link` made holds the scan, whole.

    Parameters
    ----------
    advice : str, optional
        What to do if not; absent: to delete it.
    sizes : bool, optional
        Also hold the bytes against the list.

    Raises
    ------
    InputError
        As files.check_series does.
    """
    for series in scan.series:
        where = Path(folder) / series.modality.lower()
        found = instances(where) if where.is_dir() else ()
        check_series(found, series, str(folder), advice or f"delete {folder} and run snakemake fetch again", sizes)


def _write_source(scan: PublicScan, folder: Path, places: Mapping[str, str]) -> None:
    """Whose data they are, and where they come from."""
    collection = COLLECTIONS[scan.collection]
    content = {
        "collection": collection.title,
        "doi": collection.doi,
        "licence": collection.licence,
        "archive": "The Cancer Imaging Archive, by NCI Imaging Data Commons",
        "scan": scan.name,
        "description": scan.description,
        "series": [
            {
                "modality": series.modality,
                "uid": series.uid,
                "files": series.files,
                "megabytes": series.megabytes,
                "from": places[series.modality],
            }
            for series in scan.series
        ],
    }
    (folder / SOURCE).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
