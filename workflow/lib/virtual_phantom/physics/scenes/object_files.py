"""Where the files of objects of shapes lie.

Apart from `objects`, whose imports every start of the workflow would pay.
"""

from __future__ import annotations

from pathlib import Path

from ...base.data import RESOURCES
from ...base.errors import InputError, meant

FOLDER = RESOURCES / "objects"


def shipped() -> list[str]:
    """Names of the objects that come with the library."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def path_of(kind: str) -> Path:
    """The file of an object.

    Parameters
    ----------
    kind : str
        Name of one that comes with the library, or the path of a YAML file.

    Raises
    ------
    InputError
        If there is none.
    """
    path = Path(kind)
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise InputError(f"{kind}: no such file; give the path of the object's shapes (YAML)")
        return path
    if kind not in shipped():
        raise InputError(f"there is no object '{kind}'; {meant(kind, shipped())} (a file of yours ends in .yaml)")
    return FOLDER / f"{kind}.yaml"
