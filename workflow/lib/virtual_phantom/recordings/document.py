"""recording.yaml: read, checked against its schema, and its paths kept inside the folder."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PureWindowsPath

from ..base.data import SCHEMAS, shipped_yaml
from ..base.errors import InputError, InputErrors
from ..io.files import files_of
from ..io.schema import fill_defaults, mistakes, validate
from ..io.yaml_files import read_yaml

FILE_NAME = "recording.yaml"
SCHEMA = SCHEMAS / "recording.schema.yaml"
NAME_SHOWN = 60  # characters
SECTIONS = {
    "images": {"labels", "rois", "isocentre_mm", "scan", "not_checked"},
    "projections": {"isocentre_mm", "scan", "corrected"},
}
SECTIONS["features"] = {"features", "rois"}


@dataclass(frozen=True)
class Document:
    """What recording.yaml says, complete with defaults, and the folder that it stands in."""

    folder: Path
    content: dict

    @property
    def path(self) -> Path:
        """recording.yaml itself, which messages name."""
        return self.folder / FILE_NAME

    @property
    def repeats(self) -> tuple[Path, ...]:
        """Files of the repeats, or folders of DICOM series."""
        return tuple(self.folder / name for name in self.content["repeats"])

    @property
    def held_out(self) -> tuple[Path, ...]:
        """Files or folders of the repeats that are held out."""
        return tuple(self.folder / name for name in self.content["held_out"])

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file of the recording, recording.yaml first; of a DICOM folder each file in it."""
        regions = (self.folder / name for name in _region_files(self.content))
        named = [self.path, *self.repeats, *self.held_out, *regions]
        return tuple(file for path in dict.fromkeys(named) for file in files_of(path))

    def relative(self, path: Path) -> str:
        """A path as recording.yaml writes it."""
        return path.relative_to(self.folder).as_posix()


def read_document(folder: str | Path) -> Document:
    """Read and check recording.yaml in a folder.

    Raises
    ------
    InputErrors
        A line for each mistake: if it is missing, not YAML, refused by schemas/recording.schema.yaml, holds a number
        that is not finite or a section of another kind of recording, names a file twice, or names a path that is not
        there or leads out of the folder.
    """
    folder = Path(folder)
    path = folder / FILE_NAME
    content = read_yaml(path, f"a recording is a folder with a {FILE_NAME} in it")
    found, rest = mistakes(content, _schema(), str(path))
    lines = [mistake.line for mistake in found]
    lines += _misplaced(path, rest)
    lines += _check_files(path, rest)
    if lines:
        raise InputErrors(dict.fromkeys(lines))
    fill_defaults(content, _schema())
    return Document(folder, content)


def _misplaced(path: Path, content: dict) -> Iterator[str]:
    """What has no meaning in this kind of recording."""
    if "kind" not in content:
        return
    foreign = set().union(*SECTIONS.values()) - SECTIONS[content["kind"]]
    for wrong in sorted(foreign & content.keys()):
        yield f"{path}: '{wrong}' has no meaning in a recording of {content['kind']}; take it out"
    for roi in content.get("rois", []) if content["kind"] == "features" else []:
        for cut in sorted({"margin_mm", "parts"} & roi.keys()):
            yield (
                f"{path}: rois: {cut} of {roi['name']} has no meaning in a recording of features, whose ROIs are as "
                "they were extracted; take it out"
            )


def planned_document(folder: str | Path, content: dict) -> Document:
    """The document of a recording that a job will make: its files need not be there yet.

    Parameters
    ----------
    content : dict
        As the job will write it.

    Raises
    ------
    InputError
        If schemas/recording.schema.yaml refuses it.
    """
    folder, content = Path(folder), copy.deepcopy(content)
    validate(content, _schema(), str(folder / FILE_NAME))
    fill_defaults(content, _schema())
    return Document(folder, content)


@cache
def _schema() -> dict:
    return shipped_yaml(SCHEMA)


def _region_files(content: dict) -> list[str]:
    if content.get("kind") == "features":  # they name masks that features were extracted with, wherever these are
        return []
    own = [roi["file"] for roi in content.get("rois", []) if "file" in roi]
    return [content["labels"], *own] if "labels" in content else own


def _check_files(path: Path, content: dict) -> Iterator[str]:
    """What is wrong with the files that are named."""
    kept, held_out = content.get("repeats", []), content.get("held_out", [])
    places: dict[Path, str] = {}
    for name in dict.fromkeys([*kept, *held_out, *_region_files(content)]):
        try:
            place = _inside(path, name)
        except InputError as error:
            yield str(error)
            continue
        if name in (*kept, *held_out) and places.setdefault(place, name) != name:
            yield f"{path}: '{places[place]}' and '{name}' are the same file; every repeat needs its own"
    for twice in sorted(set(kept) & set(held_out)):
        yield f"{path}: '{twice}' is among the repeats and held out; it can only be one of the two"


def _inside(path: Path, name: str) -> Path:
    """Where a named file lies; InputError if that is outside the folder or nowhere."""
    folder = path.parent.resolve()
    if Path(name).is_absolute() or PureWindowsPath(name).is_absolute() or ".." in PureWindowsPath(name).parts:
        raise InputError(f"{path}: '{name}' leads out of the folder; put the file into it and name it relative to it")
    try:
        place = (folder / name).resolve()
        there = place.exists()
    except (OSError, ValueError) as error:  # too long, or with characters that no file has
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: '{name[:NAME_SHOWN]}' cannot be the name of a file ({reason})") from None
    if place == folder or folder not in place.parents:
        raise InputError(f"{path}: '{name}' is a link out of the folder; put the file itself into it")
    if not there:
        raise InputError(f"{path}: '{name}' is not there; correct the name or put the file into the folder")
    return place
