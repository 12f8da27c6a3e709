"""Downloading of public scans with s5cmd, or linking of files that are present already.

Both create the same folder: ct/ with the slices, seg/ with the regions, and SOURCE with the origin of the data.
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
PARTIAL = ".partial-"  # prefix of the folder of an incomplete scan
WORKERS = 16  # parallel transfers
RETRIES = 5  # per request, by s5cmd, with increasing delays
SHOWN = 160  # characters of s5cmd's error message


def program() -> str:
    """Return the path of s5cmd, from PATH or next to this Python.

    Raises
    ------
    InputError
        If it is not installed.
    """
    found = shutil.which(PROGRAM) or shutil.which(PROGRAM, path=str(Path(sys.executable).parent))
    if found is None:
        raise InputError(
            f"{PROGRAM}: is not installed, but is needed to download scans; run make setup-fetch, or set "
            "downloads.scans to a folder with the scans"
        )
    return found


def manifest(scan: PublicScan, folder: Path, bucket: str) -> str:
    """Return the input of `s5cmd run`, one line per series. Files that are present with their size are skipped."""
    lines = []
    for series in scan.series:
        source, target = f"s3://{bucket}/{series.folder}/*", f"{folder / series.modality.lower()}/"
        lines.append(f"cp --if-size-differ {quote(source)} {quote(target)}\n")
    return "".join(lines)


def fetch_scan(scan: PublicScan, target: str | Path, endpoint: str, bucket: str) -> None:
    """Download one scan. The folder appears when the scan is complete and matches the list.

    Parameters
    ----------
    target : str or Path
        New folder.
    endpoint : str
        Address of the S3 service.

    Raises
    ------
    InputError
        If s5cmd is missing or fails, the disk is too full, or files do not match the list. Downloaded files are kept
        next to the target, and the next run continues from there.
    """
    target = Path(target)
    partial = target.with_name(PARTIAL + target.name)
    run = program()
    partial.mkdir(parents=True, exist_ok=True)
    _remove_incomplete(partial)
    present = sum(path.stat().st_size for path in partial.rglob("*") if path.is_file())
    needed, free = scan.megabytes * MB - present, shutil.disk_usage(partial).free
    if needed > free:
        raise InputError(
            f"{target}: needs {needed / MB:.0f} MB, but only {free / MB:.0f} MB are free; free disk space and run again"
        )
    options = ["--no-sign-request", "--endpoint-url", endpoint, "--log", "error"]
    options += ["--numworkers", str(WORKERS), "--retry-count", str(RETRIES)]
    process = subprocess.run(
        [run, *options, "run"], input=manifest(scan, partial, bucket), capture_output=True, text=True, check=False
    )
    if process.returncode:
        whole = sum(path.suffix == ".dcm" for path in partial.rglob("*"))
        raise InputError(
            f"{target}: {whole} of {scan.files} files were downloaded ({_reason(process.stderr)}); run again to "
            "continue, or correct downloads.endpoint and downloads.bucket"
        )
    check_scan(scan, partial, f"delete {partial} and run again")
    _write_source(scan, partial, {series.modality: f"s3://{bucket}/{series.folder}" for series in scan.series})
    os.replace(partial, target)


def _remove_incomplete(partial: Path) -> None:
    """Remove files that s5cmd was writing when it was killed; their names have digits after .dcm."""
    for path in partial.rglob("*"):
        if path.is_file() and path.suffix != ".dcm":
            path.unlink()


def _reason(output: str) -> str:
    """Return the first error of s5cmd, without the command that it repeats."""
    lines = output.split("\n")
    line = next((line for line in lines if line.startswith("ERROR")), lines[0] or "no reason given")
    if "send request failed" in line:
        return "no connection"
    return line.rpartition('": ')[2].partition(", request id")[0].removeprefix("ERROR ")[:SHOWN]


def link_scan(scan: PublicScan, files: Mapping[str, Iterable[Path]], target: str | Path) -> None:
    """Create the folder of a scan from links to files ({modality: files}, as from files.find_scans)."""
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
    """Check that a folder created by fetch_scan or link_scan contains the complete scan.

    By default, the advice is to delete the folder. With `sizes`, file sizes are compared with the list.

    Raises
    ------
    InputError
        As files.check_series.
    """
    for series in scan.series:
        subfolder = Path(folder) / series.modality.lower()
        found = instances(subfolder) if subfolder.is_dir() else ()
        check_series(found, series, str(folder), advice or f"delete {folder} and run snakemake fetch again", sizes)


def _write_source(scan: PublicScan, folder: Path, origins: Mapping[str, str]) -> None:
    """Write the origin and license of the data to SOURCE."""
    collection = COLLECTIONS[scan.collection]
    keys = ("modality", "uid", "files", "megabytes")
    content = {
        "collection": collection.title,
        "doi": collection.doi,
        "licence": collection.licence,
        "archive": "The Cancer Imaging Archive, by NCI Imaging Data Commons",
        "scan": scan.name,
        "description": scan.description,
        "series": [
            {key: getattr(series, key) for key in keys} | {"from": origins[series.modality]} for series in scan.series
        ],
    }
    (folder / SOURCE).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
