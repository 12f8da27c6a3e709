"""Read feature tables that other programs saved as delimited text.

`read_table` reads commas, semicolons or tabs, decimal commas, byte order marks, UTF-16, a first line `sep=;`, comments
and columns without a name. It rejects files with more than one interpretation.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..base.console import note
from ..base.errors import InputError
from ..base.names import counted
from ..io.files import NAMES, check_unchanged
from ..io.volumes import GZIP
from .names import EVERY_FAMILY, is_feature
from .names import NAMES as STUDIED
from .settings import COLUMNS

SEPARATORS = (",", ";", "\t", "|")
# Key columns of tables from pyradiomics (batch mode) and from Virtual Phantom, recognized in upper or lower case.
KEYS = ("image", "roi", "tissue_class", "Image", "Mask", "Label")
DIAGNOSTICS = "diagnostics_"
BYTE_ORDER_MARKS = (  # UTF-32 first, as its mark starts with the mark of UTF-16
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
OTHER_FORMATS = (
    (b"PK\x03\x04", "an Excel workbook or another ZIP archive; save the table as CSV"),
    (b"\xd0\xcf\x11\xe0", "an Excel workbook; save the table as CSV"),
    (b"\x00\x05\x16\x07", "an AppleDouble file with attributes of another file; give the table itself"),
    (b"PAR1", "a Parquet file; save the table as CSV"),
    (b"{", "JSON; write one row per image and ROI as CSV"),
    (b"[", "JSON; write one row per image and ROI as CSV"),
)
MISSING = frozenset(("", "nan", "-nan", "na", "n/a", "#n/a", "null", "none"))
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?inf", re.ASCII)
# Numbers in columns other than features. Entries such as 007 or 1e3 do not match, because they may be names.
PLAIN = re.compile(r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-][0-9]+)?", re.ASCII)
GROUPED = re.compile(r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+", re.ASCII)  # 7,678 or 1,061,670: may be thousands separators
FEATURE_PATTERN = re.compile(rf"(?:(.*)_)?({'|'.join(EVERY_FAMILY)})_([A-Za-z0-9]+)", re.IGNORECASE)
CLASSES = {name.lower(): name for name in EVERY_FAMILY}
# Features of pyradiomics 3.0.1 that are not among the 86 of the study, including deprecated ones.
OTHER_FEATURES = """StandardDeviation Dissimilarity Homogeneity1 Homogeneity2 MCC SumAverage SumVariance
    DependencePercentage
    Busyness Coarseness Complexity Strength Compactness1 Compactness2 Elongation Flatness LeastAxisLength
    MajorAxisLength Maximum2DDiameterColumn Maximum2DDiameterRow Maximum2DDiameterSlice Maximum3DDiameter
    MaximumDiameter MeshSurface MeshVolume MinorAxisLength Perimeter PerimeterSurfaceRatio PixelSurface
    SphericalDisproportion Sphericity SurfaceArea SurfaceVolumeRatio VoxelVolume"""
FEATURE_NAMES = {name.lower(): name for name in " ".join([*STUDIED.values(), OTHER_FEATURES]).split()}
DIAGNOSED = {name.lower(): name for name in COLUMNS}
Record = tuple[int, list[str]]


def read_table(
    path: str | Path, text: Iterable[str] = (), keep: Iterable[str] = (), advice: str = "make it again"
) -> pd.DataFrame:
    """Read a feature table from any program.

    Parameters
    ----------
    text : iterable of str, optional
        Text columns besides KEYS and `io.files.NAMES`.
    keep : iterable of str, optional
        Further columns that are not renamed.
    advice : str, optional
        What to do if the file was changed after Virtual Phantom wrote it.

    Returns
    -------
    DataFrame
        Indexed by line number in the file. Features are numbers, under the names of pyradiomics. Any other
        column has numbers if its entries match PLAIN, bools if its entries are True or False, and otherwise text. Empty
        entries are ignored for this choice, and become missing values.

    Raises
    ------
    InputError
        If the file is not delimited text, rows and header differ in length, a feature is not a number, or a decimal
        comma may be a thousands separator.
    """
    path, text = Path(path), frozenset(text)
    keep = text.union(keep)
    check_unchanged(path, advice)
    header, rows = _table(_text(path), path)
    if (form := _other_form(header, rows)) is not None:
        raise InputError(f"{path}: {form}; write one row per image and ROI, and one column per feature")
    header, rows = _complete_rows(header, rows, path)
    names = _renamed_columns(header, keep, path)
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{path}: the column {twice[0]!r} occurs twice; remove one")
    columns = {name: [fields[column].strip() for _, fields in rows] for column, name in enumerate(names) if name}
    if "" in names:
        note(f"{path}: a column without a name was skipped")
    lines = [line for line, _ in rows]
    features = {name: entries for name, entries in columns.items() if is_feature(name)}
    comma = _decimal_comma(features, lines, path)
    converted = {}
    for name, entries in columns.items():
        if name in features:
            converted[name] = _numbers(name, entries, comma, lines, path)
        else:
            converted[name] = _text_or_numbers(entries, comma, name in text or name in NAMES or name in KEYS)
    return pd.DataFrame(converted, index=pd.Index(lines, dtype=int), columns=list(columns))


def _text(path: Path) -> str:
    try:
        content = path.read_bytes()
        if content.startswith(GZIP):
            content = gzip.decompress(content)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as CSV ({reason})") from None
    for signature, format_and_advice in OTHER_FORMATS:
        if content.startswith(signature):
            raise InputError(f"{path}: is {format_and_advice}")
    encoding = next((name for mark, name in BYTE_ORDER_MARKS if content.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in content:  # UTF-16 without a mark: every second byte of a digit is zero
        even, odd = content[::2].count(0), content[1::2].count(0)
        if max(even, odd) > len(content) / 4 and not min(even, odd):
            encoding = "utf-16-be" if even else "utf-16-le"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {line} is not {encoding.upper()} text; save the table as CSV UTF-8") from None
    if "\0" in text:
        raise InputError(f"{path}: is not text; save the table as CSV UTF-8")
    return text


def _table(text: str, path: Path) -> tuple[list[str], list[Record]]:
    """Return the header, and the data records with their line numbers, without blank lines and comments."""
    lines = text.splitlines()
    first = next((line for line in lines if line.strip()), None)
    if first is None:
        raise InputError(f"{path}: cannot be read as CSV (it is empty)")
    declared = re.fullmatch(r'"?sep=(.)"?[,;\t|]*', first.strip(" \ufeff"), re.IGNORECASE)
    beginning = [line for line in lines if line.strip() and not (declared and line is first)]
    header_line = _header_line(beginning)
    separator = declared[1] if declared else _separator(header_line)
    records = _records(text, separator, path)
    if declared:
        del records[0]
    header: list[str] | None = None
    rows, comments = [], 0
    for line, fields in records:
        if header is None:
            if fields[0].startswith("#") and fields != _split(header_line, separator):
                comments += 1
            else:
                header = [field.strip(" \ufeff") for field in fields]
                header[0] = header[0].lstrip("# ")
        elif fields[0].startswith("#") and len(fields) != len(header):
            comments += 1
        else:
            rows.append((line, fields))
    if header is None or len(header) < 2:
        found = "" if header is None else f" ({header[0][:40]!r} has one)"
        raise InputError(
            f"{path}: its first line does not hold the names of several columns{found}; separate them by commas, "
            "semicolons or tabs"
        )
    if comments:
        note(f"{path}: {counted(comments, 'comment line')} skipped")
    return header, rows


def _header_line(lines: Sequence[str]) -> str:
    """Return the first line that is not a comment, or that is a comment with as many columns as the next line.

    numpy.savetxt writes such headers.
    """
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        separator = _separator(line)
        number = len(_split(line, separator))
        if not line.startswith("#") or (number > 1 and number == len(_split(following, separator))):
            return line
    return ""


def _split(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])


def _separator(line: str) -> str:
    """Return the separator that gives the most known column names, then the most columns."""

    def score(separator: str) -> tuple[int, int]:
        names = [name.strip() for name in _split(line, separator)]
        return sum(_known(name) for name in names), len(names)

    return max(SEPARATORS, key=score)


def _known(name: str) -> bool:
    return name in KEYS or name.startswith(DIAGNOSTICS) or is_feature(_feature_name(name) or name)


def _records(text: str, separator: str, path: Path) -> list[Record]:
    """Return all records that are not empty, with the number of their first line."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True, strict=True)
    records, start = [], 1
    try:
        for fields in reader:
            if any(field.strip() for field in fields):
                records.append((start, fields))
            start = reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as CSV (line {start}: {error})") from None
    return records


def _other_form(header: Sequence[str], rows: Sequence[Record]) -> str | None:
    """Return what is wrong if the rows, not the columns, are features; otherwise None."""
    if any(map(_known, set(header) - set(KEYS))) or len(rows) < 2:
        return None
    for column in range(min(len(header), 4)):
        named = sum(_known(fields[column].strip()) for _, fields in rows if column < len(fields))
        if named > len(rows) / 2:
            return "is transposed: each row is a feature" if column == 0 else "is in long form: each row is a feature"
    return None


def _complete_rows(header: list[str], rows: list[Record], path: Path) -> tuple[list[str], list[Record]]:
    """Remove empty columns at the end, and check that header and rows have the same length."""
    while header and not header[-1] and not any("".join(fields[len(header) - 1 :]).strip() for _, fields in rows):
        header = header[:-1]
    width = len(header)
    trimmed = [(line, fields[:width] if not "".join(fields[width:]).strip() else fields) for line, fields in rows]
    for line, fields in trimmed:
        if sum(field.strip() == name for field, name in zip(fields, header, strict=False)) > width / 2:
            raise InputError(
                f"{path}: row {line} repeats the column names, as if a second table had been appended; keep one of them"
            )
    wrong = [(line, len(fields)) for line, fields in trimmed if len(fields) != width]
    if len(wrong) == len(trimmed) > 1 and {number for _, number in wrong} == {width + 1}:
        raise InputError(
            f"{path}: every row has one field more than the header, {width + 1} and {width}; name the first column (in "
            "R: write.csv with row.names = FALSE)"
        )
    if wrong:
        line, number = wrong[0]
        lengths = {number for _, number in wrong}
        if number < width:
            advice = "is a value missing, or was the file cut off?"
        elif len(wrong) == len(trimmed) > 1 and len(lengths) == 1:
            advice = "is the first line a title? Delete the lines before the column names"
        elif number % width == 0:
            advice = "are several rows in one line?"
        else:
            advice = "is a decimal comma among them?"
        more = f" (and {counted(len(wrong) - 1, 'more row')})" if len(wrong) > 1 else ""
        raise InputError(f"{path}: row {line} has {number} fields and the header {width}{more}; {advice}")
    return header, trimmed


def _renamed_columns(header: Sequence[str], keep: frozenset[str], path: Path) -> list[str]:
    """Rename columns to the names that pyradiomics and Virtual Phantom write."""
    names, renamed = list(header), []
    for column, name in enumerate(header):
        other = DIAGNOSED.get(name.lower()) or _feature_name(name) or name
        if name not in keep and other != name:
            names[column] = other
            renamed.append((name, other))
    if renamed:
        name, other = renamed[0]
        note(f"{path}: {counted(len(renamed), 'column')} read under the names of pyradiomics ({name} as {other})")
    normalized_names = {_normalized(name) for name in names}
    for key in KEYS:
        # With a column Mask, the table is from pyradiomics and the key is Image; without, the key is image.
        if key == ("image" if "mask" in normalized_names else "Image"):
            continue
        alike = [
            column for column, name in enumerate(names) if _normalized(name) == _normalized(key) and name not in keep
        ]
        if len(alike) == 1 and names[alike[0]] not in KEYS:
            names[alike[0]] = key
    return names


def _normalized(name: str) -> str:
    return re.sub(r"[\s_-]+", "_", name).lower()


def _feature_name(name: str) -> str | None:
    """Convert a feature name in another case, without image type or with other separators to pyradiomics' form."""
    match = FEATURE_PATTERN.fullmatch(re.sub(r"[\s.]+", "_", name)) or FEATURE_PATTERN.fullmatch(name)
    if match is None or match[3].lower() not in FEATURE_NAMES:
        return None
    image_type = (match[1] or "original").replace("_", "-")
    image_type = image_type.lower() if image_type.lower() == "original" else image_type
    return f"{image_type}_{CLASSES[match[2].lower()]}_{FEATURE_NAMES[match[3].lower()]}"


def _decimal_comma(features: dict[str, list[str]], lines: Sequence[int], path: Path) -> bool:
    """Return whether numbers have a decimal comma; reject thousands separators and ambiguous commas."""
    first: dict[str, str] = {}
    for name, entries in features.items():
        for line, entry in zip(lines, entries, strict=True):
            if "," not in entry:
                kind = "point" if "." in entry else ""
            elif "." in entry or entry.count(",") > 1:
                kind = "thousands"
            else:
                kind = "either" if GROUPED.fullmatch(entry) else "comma"
            if kind and kind not in first:
                first[kind] = f"{name} is '{entry}' in row {line}"
    if "thousands" in first:
        raise InputError(f"{path}: {first['thousands']}; save the table without thousands separators")
    comma = first.get("comma") or first.get("either")
    if comma and "point" in first:
        raise InputError(f"{path}: {comma} and {first['point']}; write all numbers with a decimal point")
    if "either" in first and "comma" not in first:
        raise InputError(f"{path}: {comma}, which may be a decimal comma or not; write numbers with a decimal point")
    return comma is not None


def _numbers(name: str, entries: Sequence[str], comma: bool, lines: Sequence[int], path: Path) -> np.ndarray:
    numbers = np.full(len(entries), np.nan)
    for row, entry in enumerate(entries):
        if entry.lower() in MISSING:
            continue
        number = entry.replace(",", ".") if comma else entry
        if not NUMBER.fullmatch(number):
            raise InputError(f"{path}: {name} holds text ('{entry[:40]}' in row {lines[row]}); give numbers")
        numbers[row] = float(number)
    return numbers


def _text_or_numbers(entries: Sequence[str], comma: bool, text: bool) -> pd.Series | list:
    """Convert a column other than a feature; empty entries become None."""
    if not text:
        points = [entry.replace(",", ".") if comma and entry.count(",") == 1 else entry for entry in entries]
        present = [entry for entry in points if entry]
        for match, convert in ((PLAIN.fullmatch, _number), (("True", "False").__contains__, "True".__eq__)):
            if present and all(map(match, present)):
                return [convert(entry) if entry else None for entry in points]
    return pd.array([entry or None for entry in entries], dtype="str")


def _number(entry: str) -> float:
    return int(entry) if entry.lstrip("-").isdecimal() else float(entry)
