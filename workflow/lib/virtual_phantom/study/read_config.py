"""Configuration files put together as Snakemake does it, and what is wrong with them as files."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import yaml

from ..base.data import DEFAULT_STUDY
from ..base.errors import InputError
from ..io.files import check_unchanged
from ..io.schema import check_nesting

DEFAULT = "config/config.yaml"  # what the Snakefile begins with


def read_configs(paths: Sequence[str | Path]) -> tuple[list[str], dict | None]:
    """The configuration that `snakemake --configfile` makes of files.

    Parameters
    ----------
    paths : sequence of str or Path
        A later one changes keys of those before it, the first one those of the default study: config/config.yaml
        where it is called, or the clone's.

    Returns
    -------
    lines : list of str
        Mistakes of files: not there, no YAML, a key that is there twice.
    settings : dict or None
        None, if a file cannot be read.
    """
    lines: list[str] = []
    settings: dict = {}
    readable = True
    default = next((path for path in (Path(DEFAULT), DEFAULT_STUDY) if path.exists()), None)
    for path in [*([default] if default else []), *paths]:
        try:
            own, doubled = _read(path)
        except InputError as error:
            lines.append(str(error))
            readable = False
            continue
        lines += doubled
        settings = _updated(settings, own)
    return lines, settings if readable else None


def doubled_keys(path: str | Path) -> list[str]:
    """A line for each key that a YAML file has twice in one section: of these, YAML takes the last without a word."""
    try:
        return _read(path)[1]
    except InputError:  # Snakemake says what is wrong with it, or takes it as JSON
        return []


def _read(path: str | Path) -> tuple[dict, list[str]]:
    path = Path(path)
    check_unchanged(path, "make it again")
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a configuration") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text in UTF-8; save it as such") from None
    try:
        node = yaml.compose(text, yaml.SafeLoader)
        content = yaml.safe_load(text)
        doubled = [f"{path}: {line}" for line in _doubled(node, ())] if node is not None else []
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", None) or error).split())
        hint = "; indent by spaces, not tabs" if "'\\t'" in reason else ""
        raise InputError(f"{path}{place}: cannot be read as YAML ({reason}){hint}; correct this line") from None
    except (ValueError, RecursionError) as error:  # dates that are none, nesting without end
        raise InputError(f"{path}: cannot be read as YAML ({' '.join(str(error).split())})") from None
    if content is None:
        return {}, doubled
    if not isinstance(content, dict):
        raise InputError(f"{path}: is not a mapping of keys to values; see config/README.md for the keys")
    check_nesting(content, str(path))
    return content, doubled


def _doubled(node: yaml.Node, place: tuple, depth: int = 0) -> Iterator[str]:
    if depth > 40:
        return
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            name = str(key.value)
            line = key.start_mark.line + 1
            if name in seen:
                where = ".".join((*place, name))
                yield f"{where} is there twice, in lines {seen[name]} and {line}; YAML takes the last: join them"
            seen.setdefault(name, line)
            yield from _doubled(value, (*place, name), depth + 1)
    elif isinstance(node, yaml.SequenceNode):
        for number, value in enumerate(node.value):
            yield from _doubled(value, (*place, str(number)), depth + 1)


def _updated(settings: Mapping, own: Mapping) -> dict:
    """As snakemake.utils.update_config: sections are merged, anything else is replaced."""
    merged = copy.deepcopy(dict(settings))
    for key, value in own.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = _updated(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged
