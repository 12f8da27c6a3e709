"""Read configuration files and merge them as Snakemake does."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from ..base.console import note
from ..base.data import clone
from ..base.errors import InputError, did_you_mean, refusing
from ..io.study_sizes import paper_groups
from ..io.yaml_files import parse_yaml

DEFAULT = "config/config.yaml"  # the default study
PAPER_GROUPS = "config/paper_groups.yaml"
# Sections whose entries can be removed by null.
REMOVABLE = (
    ("protocols",),
    ("noise", "levels"),
    ("analyses",),
    ("analyses", "pca"),
    ("analyses", "comparison"),
    ("scans",),
    ("recordings",),
    ("public_scans",),
    ("public_scans", "phantom"),
    ("public_scans", "compared"),
    ("diagnosis", "recordings"),
    ("diagnosis", "scanners"),
)
ADVICE = "give the path of a configuration (see config/README.md)"


def read_configs(paths: Sequence[str | Path]) -> tuple[list[str], dict | None]:
    """Return the configuration that `snakemake --configfile` reads from files.

    Parameters
    ----------
    paths : sequence of str or Path
        Later files change keys of earlier files. The first file changes the study of the last key `base`, by default
        config/config.yaml, in the current folder or in the clone. The installed package has a copy of
        config/paper_groups.yaml.

    Returns
    -------
    lines : list of str
        Errors of the files: missing, no YAML, a duplicate key, a number that YAML reads as another number.
    settings : dict or None
        None if a file cannot be read.
    """
    lines: list[str] = []
    contents = {path: _read(path, lines) for path in paths}
    base = study_changed_by({key: value for content in contents.values() for key, value in (content or {}).items()})
    found = next((path for path in (Path(base), (clone() or Path()) / base) if path.exists()), None)
    if found:
        before: list[str] = []
        contents = {found: _read(found, before)} | {
            path: content for path, content in contents.items() if content is None or not Path(path).samefile(found)
        }
        lines, settings = before + lines, {}
    elif base == PAPER_GROUPS:
        settings = shipped_paper_groups()
    else:
        return [f"{base}: not in this folder or in a clone; run in a clone, or set base: {PAPER_GROUPS}"], None
    for path, content in contents.items():
        for line in _idle_nulls(settings, content or {}):
            note(f"{path}: {line}")
        settings = _updated(settings, content or {})
    return lines, None if None in contents.values() else settings


def section_at(settings: object, *path: str) -> dict:
    """Return the section of a configuration at a path of keys; {} if there is none."""
    for key in path:
        settings = settings.get(key) if isinstance(settings, Mapping) else None
    return settings if isinstance(settings, Mapping) else {}


def study_changed_by(settings: Mapping) -> str:
    """Return the file of the study that a configuration changes, the default study unless its key `base` names one."""
    base = settings.get("base")
    return base if base in (DEFAULT, PAPER_GROUPS) else DEFAULT  # the schema rejects others


def _read(path: str | Path, lines: list[str]) -> dict | None:
    """Return the content of a file, None if it cannot be read; add its errors to `lines`."""
    try:
        content, doubtful = parse_yaml(path, ADVICE, template=_rendered)
    except InputError as error:
        lines.append(str(error))
        return None
    lines += doubtful
    return content


def _idle_nulls(settings: Mapping, content: Mapping) -> Iterator[str]:
    """Yield a line for each null in the content of a file that removes no entry of the settings."""
    for path in REMOVABLE:
        existing = section_at(settings, *path)
        for name, value in section_at(content, *path).items():
            if value is None and name not in existing:
                where = ".".join((*path, str(name)))
                others = [str(key) for key, value in existing.items() if value is not None]
                yield f"{where}: null removes nothing, as there is no such entry; {did_you_mean(str(name), others)}"


def doubtful_entries(path: str | Path) -> list[str]:
    """Return a line for each value that Snakemake probably reads differently from what is meant.

    These are duplicate keys, of which YAML takes the last, and numbers such as 010, which YAML reads as 8.
    """
    try:
        return parse_yaml(path, ADVICE)[1]
    except InputError:  # Snakemake has read it
        return []


def shipped_paper_groups() -> dict:
    """Return config/paper_groups.yaml from the library's resources, for use without a clone."""
    study = paper_groups()
    noise = {"model": "astra", "levels": study["levels"]}
    sections = {key: study[key] for key in ("grid", "scan", "protocols", "analyses")}
    named = {"base": PAPER_GROUPS, "phantom": {"source": "synthetic"}, "results_dir": "results-paper-groups"}
    return {**named, **sections, "noise": noise}


def _rendered(text: str) -> dict:
    """Return a configuration that is a YTE template, as Snakemake renders it."""
    try:
        import yte  # Snakemake installs it
    except ImportError:
        raise InputError(
            "__use_yte__: this configuration is a template, and yte is not installed; install Snakemake"
        ) from None
    with refusing("__use_yte__: this template cannot be rendered", Exception, advice="correct it"):
        return yte.process_yaml(text, require_use_yte=True)


def _updated(settings: Mapping, changes: Mapping) -> dict:
    """Merge sections and replace other values, as snakemake.utils.update_config does."""
    merged = copy.deepcopy(dict(settings))
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = _updated(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged
