"""Paths of object files. Separate from `objects`, whose imports are slow and not needed at every start."""

from __future__ import annotations

from pathlib import Path

from ...base.data import RESOURCES
from ...base.errors import InputError, did_you_mean

FOLDER = RESOURCES / "objects"


def object_names() -> list[str]:
    """Return the names of the objects in the library."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def object_path(kind: str) -> Path:
    """Return the file of an object.

    Parameters
    ----------
    kind : str
        Name of an object in the library, or path of a YAML file.

    Raises
    ------
    InputError
        If it does not exist.
    """
    path = Path(kind)
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise InputError(f"{kind}: no such file; give the path of the object's shapes (YAML)")
        return path
    if kind not in object_names():
        raise InputError(
            f"there is no object '{kind}'; {did_you_mean(kind, object_names())} (a file of yours ends in .yaml)"
        )
    return FOLDER / f"{kind}.yaml"
