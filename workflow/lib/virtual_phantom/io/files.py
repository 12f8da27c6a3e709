"""Atomic writing, and checksums of files.

A file is written under a temporary name and renamed, so that readers never see a part of it. Its SHA-256 is in a hidden
file next to it (.table.csv.sha256 for table.csv, readable by `sha256sum --check`). Changed files are refused; files
without a checksum, such as users' files, are accepted.
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
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EDQUOT: "the quota is used up; free some space and run again",
    errno.EROFS: "the file system is read-only; set another results_dir",
    errno.EACCES: "the folder may not be written to; change its permissions or set another results_dir",
    errno.EPERM: "the folder may not be written to; change its permissions or set another results_dir",
    errno.ENAMETOOLONG: "the name is too long; give shorter names",
}

# Columns of names. A name may look like a number, a truth value or a missing value: 01, 1e3, true, NA, null.
NAMES = frozenset(
    """algorithm collection condition effect family feature file image kernel kind label_in_file name noise
    numpy_version pca property protocol pyradiomics_version recording reconstruction region roi scan settings
    settings_hash simpleitk_version source tissue_class""".split()
) | {"change", "change_from", "change_to", "insert", "material", "module", "setting", "use"}
# How pandas writes a number or a truth value. Other text, such as 007 or 1e3, is a name.
VALUE = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:e[+-]\d\d+)?|-?inf|True|False")


@contextlib.contextmanager
def replacing(path: str | Path, checksum: bool = True) -> Iterator[Path]:
    """Yield a temporary path in the same folder; replace the file by it if the block succeeds.

    Parameters
    ----------
    path : str or Path
        The file. A missing folder is created.
    checksum : bool, optional
        Write the SHA-256, for files that are read again.

    Yields
    ------
    Path
        Has the suffixes of `path`, which NIfTI and figure writers use to choose the format.

    Raises
    ------
    InputError
        If the disk is full, the folder cannot be created or written to, or the path is a folder. The old file then
        stays.
    OSError
        For other errors of the system.
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
        # A process that is killed between these steps leaves a complete file without a checksum.
        kept.unlink(missing_ok=True)
        os.replace(temporary, path)
        if checksum:
            os.replace(beside, kept)
    except OSError as error:
        # NumPy reports the number of written bytes but not the reason.
        number = errno.ENOSPC if "requested and" in str(error) else error.errno
        reason = DISK_PROBLEMS.get(number)
        if reason is None and not temporaries:  # the folder cannot be created or written to
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
    """Return the SHA-256 of a file, hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def checksum_path(path: str | Path) -> Path:
    """Return the path of a file's checksum."""
    path = Path(path)
    return path.with_name(f".{path.name}.sha256")


def check_unchanged(path: str | Path, advice: str = "delete it and run again") -> None:
    """Check that a file agrees with its checksum.

    A missing file, or one without a checksum, passes: its reader reports other problems.

    Raises
    ------
    InputError
        If the file was changed; the message ends with `advice`.
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
    """Write a DataFrame without its index; floats have the shortest text that reads back to the same number."""
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")


def write_parquet(table, path: str | Path) -> None:
    """Write a DataFrame without its index as Parquet, which stores the type of every column."""
    with replacing(path, checksum=False) as temporary:  # for other programs; Virtual Phantom reads the CSV
        table.to_parquet(temporary, index=False)


def read_csv(path: str | Path, advice: str = "delete it and run again", numbers: Sequence[str] = ()):
    """Read a table of `write_csv`; columns of NAMES are text.

    Any other column has numbers or truth values if all its entries are written as pandas writes these, otherwise text.
    Empty entries are NaN; the text NA is not missing.

    Parameters
    ----------
    advice : str, optional
        End of the message if the file cannot be read.
    numbers : sequence of str, optional
        Columns of numbers although their names are in NAMES.

    Raises
    ------
    InputError
        If the file is missing, empty, changed, or not a table.
    """
    import pandas

    check_unchanged(path, advice)
    options = {"keep_default_na": False, "na_values": [""], "index_col": False, "low_memory": False}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pandas.errors.ParserWarning)  # all rows are longer than the header
            table = pandas.read_csv(path, dtype=dict.fromkeys(NAMES - set(numbers), str), **options)
            # Only whole numbers and truth values may be names: 007, 1e3, true.
            doubtful = [name for name in table if name not in NAMES and _integers(table[name])]
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


def _integers(column) -> bool:
    """Return whether a column has truth values, or numbers that are all integers, infinite or missing."""
    if column.dtype.kind != "f":
        return column.dtype.kind in "biu"
    values = column.to_numpy()
    return bool(((values == values.round()) | (values != values)).all())


def write_text(text: str, path: str | Path) -> None:
    """Write a UTF-8 text file."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_text(path: str | Path, advice: str = "delete it and run again") -> str:
    """Read a UTF-8 text file. Errors of Path.read_text pass.

    Raises
    ------
    InputError
        If the file was changed; the message ends with `advice`.
    """
    check_unchanged(path, advice)
    return Path(path).read_text(encoding="utf-8")


def files_of(path: str | Path) -> list[Path]:
    """Return the path of a file itself, or the files in a DICOM folder without hidden files, which the reader skips."""
    path = Path(path)
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
