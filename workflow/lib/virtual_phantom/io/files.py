"""Write beside, then rename: no reader ever sees half a file. Beside it goes its SHA-256: none reads a changed one.

The checksum of table.csv is the hidden file .table.csv.sha256, as `sha256sum --check` reads it. Files without one,
which are the user's, are taken as they are.
"""

import contextlib
import errno
import hashlib
import os
import re
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..base.errors import InputError

DISK_PROBLEMS = {
    errno.ENOSPC: "the disk is full; make room and run again",
    errno.EDQUOT: "the quota is used up; make room and run again",
    errno.EROFS: "the file system is read-only; set another results_dir",
    errno.EACCES: "the folder may not be written to; change its permissions or set another results_dir",
    errno.EPERM: "the folder may not be written to; change its permissions or set another results_dir",
    errno.ENAMETOOLONG: "the name is too long; give shorter names",
}

# Columns of names. A name may look like a number, a truth value or a gap: 01, 1e3, true, NA, null.
NAMES = frozenset(
    """algorithm collection condition effect family feature file image kernel kind label_in_file name noise
    numpy_version pca property protocol pyradiomics_version recording reconstruction region roi scan settings
    settings_hash simpleitk_version source tissue_class""".split()
)
# How pandas writes a number or a truth value. Other text, such as 007 or 1e3, is a name.
VALUE = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:e[+-]\d\d+)?|-?inf|True|False")


@contextlib.contextmanager
def replacing(path: str | Path, checksum: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside a file; move it there if the block succeeds.

    Parameters
    ----------
    path : str or Path
        The file. Its folder is made where it is missing.
    checksum : bool, optional
        Keep the SHA-256 beside it, for files that are read again.

    Yields
    ------
    Path
        In the same folder and with the same suffixes, because NIfTI and figure writers choose their format by them.

    Raises
    ------
    InputError
        If the disk is full, the folder cannot be made or written to, or the path is a folder; what was there before
        then stays.
    OSError
        For whatever else the system refuses.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the path of a file, or move it elsewhere")
    temporaries: list[Path] = []
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        suffix = path.name[path.name.index(".", 1) :] if "." in path.name[1:] else ""
        temporary = _temporary(path, suffix, temporaries)
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        kept = checksum_path(path)
        if checksum:
            beside = _temporary(path, ".sha256", temporaries)
            beside.write_text(f"{sha256(temporary)}  {path.name}\n", encoding="utf-8")
            beside.chmod(0o666 & ~umask)
        # Between these two steps the file has no checksum: a kill leaves it whole, and never with that of another.
        kept.unlink(missing_ok=True)
        os.replace(temporary, path)
        if checksum:
            os.replace(beside, kept)
    except OSError as error:
        # NumPy's own writer says how many bytes were written, and not why.
        number = errno.ENOSPC if "requested and" in str(error) else error.errno
        reason = DISK_PROBLEMS.get(number)
        if reason is None and not temporaries:  # the folder cannot be made or written to; the block was not entered
            reason = f"{error.strerror}; give another path"
        if reason is None:
            raise
        raise InputError(f"{path}: cannot be written: {reason}") from None
    finally:
        for temporary in temporaries:
            temporary.unlink(missing_ok=True)


def _temporary(path: Path, suffix: str, temporaries: list[Path]) -> Path:
    descriptor, name = tempfile.mkstemp(prefix=".partial-", suffix=suffix, dir=path.parent)
    os.close(descriptor)
    temporaries.append(Path(name))
    return temporaries[-1]


def sha256(path: str | Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def checksum_path(path: str | Path) -> Path:
    """Where the checksum of a file is kept."""
    path = Path(path)
    return path.with_name(f".{path.name}.sha256")


def check_unchanged(path: str | Path, advice: str = "delete it and run again") -> None:
    """Check that a file that has a checksum is what was written.

    A file that is missing, or has no checksum, passes: its reader tells what else is wrong with it.

    Raises
    ------
    InputError
        If the file was changed; `advice` says what to do about it.
    """
    path = Path(path)
    if not path.is_file():
        return
    kept = checksum_path(path)
    if kept.is_file() and kept.read_bytes().split()[:1] != [sha256(path).encode()]:
        raise InputError(
            f"{path}: is not as it was written (its SHA-256 is not that in {kept.name}); {advice}, or delete "
            f"{kept.name} if the change is meant"
        )


def write_csv(table, path: str | Path) -> None:
    """Write a pandas DataFrame without its index; floats as the shortest text that reads back to the same number."""
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")


def write_parquet(table, path: str | Path) -> None:
    """Write a pandas DataFrame without its index as Parquet, which keeps the type of every column."""
    with replacing(path, checksum=False) as temporary:  # for other programs: ours read the CSV
        table.to_parquet(temporary, index=False)


def read_csv(path: str | Path, advice: str = "delete it and run again", numbers: Sequence[str] = ()):
    """Read a table that `write_csv` wrote, with names as text, whatever they look like.

    Parameters
    ----------
    advice : str, optional
        End of the message if the file cannot be read.
    numbers : sequence of str, optional
        Columns of numbers although they are called as a column of names is (NAMES).

    Returns
    -------
    DataFrame
        Columns of NAMES are text. Any other column has numbers or truth values if all its entries are written as
        pandas writes these, else text. Empty entries are NaN; the text NA is no gap.

    Raises
    ------
    InputError
        If the file is missing, empty, changed since it was written, or no table.
    """
    import pandas

    check_unchanged(path, advice)
    options = {"keep_default_na": False, "na_values": [""], "index_col": False, "low_memory": False}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pandas.errors.ParserWarning)  # every row is longer than the header
            table = pandas.read_csv(path, dtype=dict.fromkeys(NAMES - set(numbers), str), **options)
            # Only whole numbers and truth values may be names: 007, 1e3, true.
            doubtful = [name for name in table if name not in NAMES and _whole(table[name])]
            if doubtful:
                text = pandas.read_csv(path, dtype=str, usecols=doubtful, **options)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, pandas.errors.ParserWarning) as error:  # pandas' own errors are ValueErrors
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as CSV ({reason}); {advice}") from None
    for name in doubtful:
        if not all(map(VALUE.fullmatch, text[name].dropna())):
            table[name] = text[name]
    return table


def _whole(column) -> bool:
    """Whether a column was read as truth values, or as numbers of which all are whole or infinite."""
    if column.dtype.kind != "f":
        return column.dtype.kind in "biu"
    values = column.to_numpy()
    return bool(((values == values.round()) | (values != values)).all())


def write_text(text: str, path: str | Path) -> None:
    """Write a UTF-8 text file."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_text(path: str | Path, advice: str = "delete it and run again") -> str:
    """Read a UTF-8 text file.

    Raises
    ------
    InputError
        If the file was changed since it was written; the message ends in `advice`. Path.read_text raises its own
        errors.
    """
    check_unchanged(path, advice)
    return Path(path).read_text(encoding="utf-8")


def files_of(path: str | Path) -> list[Path]:
    """The path itself, or the files in a DICOM folder, hidden ones left out as the reader leaves them out."""
    path = Path(path)
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
