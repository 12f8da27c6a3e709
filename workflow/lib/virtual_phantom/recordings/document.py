"""Reading and checking of recording.yaml. Its paths must stay inside the recording's folder."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from ..base.data import SCHEMAS
from ..base.errors import InputError, InputErrors
from ..io.files import files_of
from ..io.schema import fill_defaults, mistakes, read_schema, validate
from ..io.yaml_files import read_yaml

FILE_NAME = "recording.yaml"
SCHEMA = SCHEMAS / "recording.schema.yaml"
NAME_SHOWN = 60  # characters
# Sections and keys that have a meaning only in some kinds of recordings.
SECTIONS = {
    "images": {"labels", "rois", "isocentre_mm", "scan", "not_checked"},
    "projections": {"isocentre_mm", "scan", "corrected", "not_checked"},
    "features": {"features", "rois"},
}


@dataclass(frozen=True)
class Document:
    """Content of recording.yaml, complete with defaults, and its folder."""

    folder: Path
    content: dict

    @property
    def path(self) -> Path:
        """Path of recording.yaml, for messages."""
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
        """All files of the recording, recording.yaml first. DICOM folders count with every file in them."""
        regions = (self.folder / name for name in _region_files(self.content))
        named = [self.path, *self.repeats, *self.held_out, *regions]
        return tuple(file for path in dict.fromkeys(named) for file in files_of(path))

    def relative(self, path: Path) -> str:
        """Return a path relative to the folder, as in recording.yaml."""
        return path.relative_to(self.folder).as_posix()


def read_document(folder: str | Path) -> Document:
    """Read and check recording.yaml in a folder.

    Raises
    ------
    InputErrors
        One line per mistake. The file is missing, is not YAML or does not match schemas/recording.schema.yaml. A number
        is not finite. A section belongs to another kind of recording. A path is repeated, missing or outside the
        folder.
    """
    folder = Path(folder)
    path = folder / FILE_NAME
    content = read_yaml(path, f"a recording is a folder with a {FILE_NAME} in it")
    found, rest = mistakes(content, read_schema(SCHEMA), str(path))
    if lines := [*(mistake.line for mistake in found), *_foreign_keys(path, rest), *_check_files(path, rest)]:
        raise InputErrors(dict.fromkeys(lines))
    fill_defaults(content, read_schema(SCHEMA))
    return Document(folder, content)


def files_of_recording(path: str | Path) -> tuple[Path, ...]:
    """Return the files of a recording in a folder, or all files of a scan without recording.yaml (`files_of`)."""
    return read_document(path).files if (Path(path) / FILE_NAME).is_file() else tuple(files_of(path))


def _foreign_keys(path: Path, content: dict) -> Iterator[str]:
    """Yield a message for each key that has no meaning in this kind of recording."""
    if "kind" not in content:
        return
    foreign = set().union(*SECTIONS.values()) - SECTIONS[content["kind"]]
    for key in sorted(foreign & content.keys()):
        yield f"{path}: '{key}' has no meaning in a recording of {content['kind']}; remove it"
    for roi in content.get("rois", []) if content["kind"] == "features" else []:
        for key in sorted({"margin_mm", "parts"} & roi.keys()):
            yield (
                f"{path}: rois: {key} of {roi['name']} has no meaning in a recording of features, which were extracted "
                "already; remove it"
            )


def planned_document(folder: str | Path, content: dict) -> Document:
    """Return the document of a recording that a job will create; its files need not exist yet.

    Raises
    ------
    InputError
        If `content` does not match schemas/recording.schema.yaml.
    """
    folder, content = Path(folder), copy.deepcopy(content)
    validate(content, read_schema(SCHEMA), str(folder / FILE_NAME))
    fill_defaults(content, read_schema(SCHEMA))
    return Document(folder, content)


def _region_files(content: dict) -> list[str]:
    if content.get("kind") == "features":  # names of masks that the features were extracted with, in any folder
        return []
    files = [roi["file"] for roi in content.get("rois", []) if "file" in roi]
    return [content["labels"], *files] if "labels" in content else files


def _check_files(path: Path, content: dict) -> Iterator[str]:
    """Yield a message for each named file that is missing, repeated or outside the folder."""
    repeats, held_out = content.get("repeats", []), content.get("held_out", [])
    resolved: dict[Path, str] = {}
    for name in dict.fromkeys([*repeats, *held_out, *_region_files(content)]):
        try:
            file = _inside(path, name)
        except InputError as error:
            yield str(error)
            continue
        if name in (*repeats, *held_out) and resolved.setdefault(file, name) != name:
            yield f"{path}: '{resolved[file]}' and '{name}' are the same file; give each repeat its own file"
    for name in sorted(set(repeats) & set(held_out)):
        yield f"{path}: '{name}' is under both repeats and held_out; remove it from one of them"


def _inside(path: Path, name: str) -> Path:
    """Return the resolved path of a named file; InputError if it is missing or outside the folder."""
    folder = path.parent.resolve()
    if Path(name).is_absolute() or PureWindowsPath(name).is_absolute() or ".." in PureWindowsPath(name).parts:
        raise InputError(f"{path}: '{name}' leads out of the folder; copy the file into it and use its relative path")
    try:
        file = (folder / name).resolve()
        exists = file.exists()
    except (OSError, ValueError) as error:  # name too long, or with invalid characters
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: '{name[:NAME_SHOWN]}' is not a valid file name ({reason}); correct it") from None
    if file == folder or folder not in file.parents:
        raise InputError(f"{path}: '{name}' is a link out of the folder; copy the file itself into it")
    if not exists:
        raise InputError(f"{path}: '{name}' does not exist; correct the name or copy the file into the folder")
    return file
