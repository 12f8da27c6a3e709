"""Read YAML and JSON files of users, with one line and a line number per mistake; write values as YAML."""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import yaml

from ..base.errors import InputError, InputErrors
from .files import check_unchanged
from .schema import DEEPEST, check_nesting

# Byte order marks of encodings other than UTF-8. The first bytes of UTF-32-LE are those of UTF-16-LE.
MARKS = {
    codecs.BOM_UTF32_LE: "UTF-32",
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}
# Plain scalars that YAML 1.1 reads as another number than people expect: octal 010 (8), sexagesimal 12:30 (750) and
# 1_000 (1000). They are usually labels, names or times of day.
SURPRISING = re.compile(r"[-+]?(0[0-9_]+|[0-9_]+(:[0-5]?[0-9])+(\.[0-9_]*)?|[0-9]*_[0-9_.]*)")
NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
MERGE = "tag:yaml.org,2002:merge"


def read_yaml(path: str | Path, advice: str, *, restore: str = "make it again") -> dict:
    """Read a file that contains a mapping.

    Parameters
    ----------
    path : str or Path
        YAML or JSON, in UTF-8.
    advice : str
        What to do if the file is missing or contains no mapping, such as "give the path of a configuration".
    restore : str, optional
        What to do if the file differs from its checksum.

    Raises
    ------
    InputError
        For a file that cannot be read or contains no mapping.
    InputErrors
        With one line for each duplicate key and each number that YAML reads in an unexpected way.
    """
    content, lines = parse_yaml(path, advice, restore=restore)
    if lines:
        raise InputErrors(lines)
    return content


def one_line(value: object) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
    return text.removesuffix("\n...\n").strip()


def parse_yaml(
    path: str | Path, advice: str, *, restore: str = "make it again", template: Callable[[str], dict] | None = None
) -> tuple[dict, list[str]]:
    """Read a file that contains a mapping, and list probable mistakes in it.

    Parameters
    ----------
    path, advice, restore
        See `read_yaml`.
    template : callable, optional
        Renders a text with the key `__use_yte__`, which Snakemake's configurations may have.

    Returns
    -------
    content : dict
    lines : list of str
        The mistakes for which `read_yaml` raises InputErrors.

    Raises
    ------
    InputError
        For a file that cannot be read or contains no mapping.
    """
    path = Path(path)
    check_unchanged(path, restore)
    text = _text(path, advice)
    content, lines = _json(text, path) or _yaml(text, path)
    if content is None:
        raise InputError(f"{path}: is empty; {advice}")
    if not isinstance(content, dict):
        kind = "a list" if isinstance(content, list) else f"one value ({str(content)[:40]!r})"
        raise InputError(f"{path}: is not a mapping of keys to values but {kind}; {advice}")
    check_nesting(content, str(path))
    if template and content.pop("__use_yte__", False):
        content = template(text)
        check_nesting(content, str(path))
    return content, lines


def _text(path: Path, advice: str) -> str:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {advice}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; {advice}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read ({reason}); {advice}") from None
    for mark, encoding in MARKS.items():
        if data.startswith(mark):
            raise InputError(f"{path}: is text in {encoding}; save it in UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}, line {line}: is not text in UTF-8; save the file in UTF-8 (it may be in Latin-1)"
        ) from None


def _json(text: str, path: Path) -> tuple[object, list[str]] | None:
    """Return the content of JSON, and a line for each duplicate key; None for anything else."""
    doubled: list[str] = []

    def mapping(pairs: list[tuple[str, object]]) -> dict:
        keys = [key for key, _ in pairs]
        doubled.extend(
            f"{path}: the key '{key}' occurs twice in one section; JSON uses the last one: merge them"
            for key in dict.fromkeys(keys)
            if keys.count(key) > 1
        )
        return dict(pairs)

    try:
        return json.loads(text, object_pairs_hook=mapping), doubled
    except (ValueError, RecursionError):
        return None


def _yaml(text: str, path: Path) -> tuple[object, list[str]]:
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None, []
        lines = [f"{path}: {line}" for line in _doubtful(node, (), set())]  # before merge keys are expanded
        return loader.construct_document(node), lines
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", None) or error).split())
        if "'\\t'" in reason or (mark and "\t" in _line(text, mark.line)[: mark.column + 1]):
            reason += "; indent by spaces, not tabs"
        raise InputError(f"{path}{place}: cannot be read as YAML ({reason}); correct this line") from None
    except (ValueError, TypeError, RecursionError) as error:  # invalid dates, unhashable keys, deep nesting
        raise InputError(f"{path}: cannot be read as YAML ({' '.join(str(error).split())}); correct it") from None


def _line(text: str, number: int) -> str:
    lines = text.splitlines()
    return lines[number] if number < len(lines) else ""


def _doubtful(node: yaml.Node, place: tuple[str, ...], seen: set[int]) -> Iterator[str]:
    """Yield mistakes: duplicate keys, and scalars that YAML 1.1 reads in an unexpected way; each node once."""
    if id(node) in seen or len(place) > DEEPEST:
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        lines: dict[object, int] = {}
        for key, value in node.value:
            name, line = str(key.value) if isinstance(key, yaml.ScalarNode) else "a key", key.start_mark.line + 1
            where = (*place, name)
            if key.tag != MERGE:  # several << keys are valid
                meant = _key(key)
                if meant in lines:
                    yield (
                        f"{'.'.join(where)} occurs twice, in lines {lines[meant]} and {line}; YAML uses the last one: "
                        "merge them"
                    )
                lines.setdefault(meant, line)
                yield from _surprising(key, f"the key in {'.'.join(place)}" if place else "the key")
            yield from _doubtful(value, where, seen)
    elif isinstance(node, yaml.SequenceNode):
        for number, value in enumerate(node.value):
            yield from _doubtful(value, (*place, str(number)), seen)
    else:
        yield from _surprising(node, ".".join(place))


def _key(node: yaml.Node) -> object:
    """Return the Python value of a key, so that 1 and 01 are equal."""
    try:
        key = yaml.constructor.SafeConstructor().construct_object(node)
        hash(key)
        return key
    except (yaml.YAMLError, ValueError, TypeError):
        return id(node)


def _surprising(node: yaml.Node, where: str) -> Iterator[str]:
    if not isinstance(node, yaml.ScalarNode) or node.style is not None:
        return
    value = str(node.value)
    if node.tag in NUMBERS and SURPRISING.fullmatch(value):
        read = yaml.safe_load(value)
        yield (
            f"line {node.start_mark.line + 1}: {where} is {value}, which YAML reads as {read}; write {read} if it is a "
            f'number, or "{value}" in quotes if it is a name'
        )
