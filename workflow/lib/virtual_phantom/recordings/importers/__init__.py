"""Make recording folders from other formats: one module per format, and what they share.

Every importer writes a new folder in the format of docs/how-to/recordings.md, stores the checksums of its sources, and
loads the result to check it.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import yaml

from ...base.errors import InputError, InputErrors, lines_of
from ..document import FILE_NAME
from ..reading import load_recording
from ..recording import Recording

NAME = re.compile(r"[A-Za-z0-9_]+")


def write_folder(folder: str | Path, content: dict, write_data: Callable[[Path], None]) -> Recording:
    """Write a recording folder and load it. The folder appears only when it is complete and loads.

    Parameters
    ----------
    content : dict
        What stands in recording.yaml, but for the name, which is that of the folder.
    write_data : callable
        Called with the folder, writes the data files.

    Raises
    ------
    InputError
        If the folder is there already, or is named otherwise than in letters, digits and underscores.
    InputErrors
        If the recording cannot be loaded: a line for each mistake.
    """
    folder = Path(folder)
    if not NAME.fullmatch(folder.name):
        raise InputError(f"{folder}: name the folder in letters, digits and underscores: it names the recording")
    if folder.exists():
        raise InputError(f"{folder}: is there already; name a new folder, or remove that one first")
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder.parent))
    try:
        beside.chmod(0o755)
        write_data(beside)
        text = yaml.safe_dump({"name": folder.name, **content}, sort_keys=False, allow_unicode=True, width=120)
        (beside / FILE_NAME).write_text(text, encoding="utf-8")
        load_recording(beside)
        beside.rename(folder)
    except InputError as error:
        raise InputErrors(line.replace(str(beside), str(folder)) for line in lines_of(error)) from None
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return load_recording(folder)
