"""Write beside, then rename: no reader ever sees half a file."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from .errors import InputError


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path` with the same suffixes; move it to `path` if the block succeeds.

    The suffixes are kept because NIfTI and figure writers choose their format by them.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    suffix = path.name[path.name.index(".", 1) :] if "." in path.name[1:] else ""
    descriptor, name = tempfile.mkstemp(prefix=".partial-", suffix=suffix, dir=path.parent)
    os.close(descriptor)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_csv(table, path: str | Path) -> None:
    """Write a pandas DataFrame without its index; floats as the shortest text that reads back to the same number."""
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")


def write_parquet(table, path: str | Path) -> None:
    """Write a pandas DataFrame without its index as Parquet, which keeps the type of every column."""
    with replacing(path) as temporary:
        table.to_parquet(temporary, index=False)


def read_csv(path: str | Path, advice: str = "delete it and run again", **options):
    """A pandas DataFrame of a CSV; `options` are pandas'. Raises InputError if it is missing, empty
    or no table."""
    import pandas

    try:
        return pandas.read_csv(path, **options)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # pandas' own errors on broken files are ValueErrors
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as CSV ({reason}); {advice}") from None


def write_text(text: str, path: str | Path) -> None:
    """Write a UTF-8 text file."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def files_of(path: str | Path) -> list[Path]:
    """The path itself, or the files in a DICOM folder, hidden ones left out as the reader leaves them out."""
    path = Path(path)
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
