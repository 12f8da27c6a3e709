"""Conversion of other formats to recording folders (docs/how-to/recordings.md): one module per format.

Every importer takes a source, the new folder and, optionally, a description of the scanned object. It stores checksums
of its sources and checks the result by loading it.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import tempfile
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import yaml

from ...base.errors import InputError, InputErrors, lines_of, refusing
from ...io.files import sha256
from ...io.hdf5 import new_file
from ..document import FILE_NAME
from ..reading import load_recording
from ..recording import Recording

NAME = re.compile(r"[A-Za-z0-9_]+")


def write_folder(
    folder: str | Path, kind: str, phantom: str | None, content: dict, write_data: Callable[[Path], None]
) -> Recording:
    """Write a recording folder and load it. The folder appears only when it is complete and loads.

    Parameters
    ----------
    phantom : str or None
        Scanned object, for recording.yaml.
    content : dict
        Further content of recording.yaml. The name is the name of the folder.
    write_data : callable
        Called with the folder, writes the data files.

    Raises
    ------
    InputError
        If the folder exists, cannot be written, or its name has other characters than letters, digits and underscores.
    InputErrors
        If the recording cannot be loaded: one line per mistake.
    """
    folder = Path(folder)
    if not NAME.fullmatch(folder.name):
        raise InputError(
            f"{folder}: use only letters, digits and underscores in the folder's name, which names the recording"
        )
    if folder.exists():
        raise InputError(f"{folder}: already exists; use another folder, or remove this one")
    with refusing(f"{folder}: cannot be written", OSError, advice="use another folder"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder.parent))
    content = {"name": folder.name, "kind": kind, **({"phantom": phantom} if phantom else {}), **content}
    try:
        partial.chmod(0o755)
        write_data(partial)
        text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120)
        (partial / FILE_NAME).write_text(text, encoding="utf-8")
        load_recording(partial)
        partial.rename(folder)
    except InputError as error:
        raise InputErrors(line.replace(str(partial), str(folder)) for line in lines_of(error)) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return load_recording(folder)


def one_checksum(paths: Collection[Path]) -> dict:
    """Return one checksum of many files for `origin`: sha256sum * | cut -d' ' -f1 | sort | sha256sum."""
    lines = "".join(f"{digest}\n" for digest in sorted(map(sha256, paths)))
    return {"files": len(paths), "sha256": [hashlib.sha256(lines.encode()).hexdigest()]}


def write_projections(
    path: Path,
    data: np.ndarray,
    angles_deg: np.ndarray | None,
    white: np.ndarray | None = None,
    dark: np.ndarray | None = None,
    **options,
) -> None:
    """Write projections [view, row, column] in the Data Exchange layout: line integrals without a white field.

    Options are of h5py.
    """
    with new_file(path) as file:
        stored = file.create_dataset("exchange/data", data=data, compression="gzip", **options)
        stored.attrs["log"] = white is None
        if white is not None:
            file.create_dataset("exchange/data_white", data=white[None], compression="gzip")
            file.create_dataset("exchange/data_dark", data=dark[None], compression="gzip")
        if angles_deg is not None:
            file.create_dataset("exchange/theta", data=angles_deg).attrs["units"] = "degree"
