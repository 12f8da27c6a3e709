"""Configuration files put together as Snakemake does it, and what is wrong with them as files."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from ..base.console import note
from ..base.data import clone
from ..base.errors import InputError, meant, refusing
from ..io.default_study import default_study
from ..io.yaml_files import parse_yaml

DEFAULT = "config/config.yaml"  # what the Snakefile begins with
# Sections whose entries null removes.
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
    """The configuration that `snakemake --configfile` makes of files.

    Parameters
    ----------
    paths : sequence of str or Path
        A later one changes keys of those before it, the first one those of the default study: config/config.yaml
        in the current folder, the clone's, or what the installed package has of it.

    Returns
    -------
    lines : list of str
        Mistakes of files: not there, no YAML, a key that is there twice, a number that YAML reads as another one.
    settings : dict or None
        None, if a file cannot be read.
    """
    lines: list[str] = []
    default = _default()
    settings: dict = {} if default else shipped_default()
    readable = True
    for path in [*([default] if default else []), *paths]:
        try:
            own, doubtful = parse_yaml(path, ADVICE, template=_rendered)
        except InputError as error:
            lines.append(str(error))
            readable = False
            continue
        lines += doubtful
        for line in _idle_nulls(settings, own):
            note(f"{path}: {line}")
        settings = _updated(settings, own)
    return lines, settings if readable else None


def note_idle_nulls(paths: Sequence[str | Path]) -> None:
    """Print a note for each null that removes nothing, for configurations that Snakemake has read."""
    default = _default()
    read_configs([path for path in paths if default is None or not Path(path).samefile(default)])


def _default() -> Path | None:
    """The default study's file: in the current folder or in the clone."""
    return next((path for path in (Path(DEFAULT), (clone() or Path()) / DEFAULT) if path.exists()), None)


def _idle_nulls(settings: Mapping, own: Mapping) -> Iterator[str]:
    """A line for each entry that a configuration removes by null from settings that do not have it."""
    for path in REMOVABLE:
        before, after = settings, own
        for key in path:
            before = before.get(key) if isinstance(before, Mapping) else None
            after = after.get(key) if isinstance(after, Mapping) else None
        there = before if isinstance(before, Mapping) else {}
        for name in [key for key, value in after.items() if value is None] if isinstance(after, Mapping) else ():
            if name not in there:
                where = ".".join((*path, str(name)))
                others = [str(key) for key, value in there.items() if value is not None]
                yield f"{where}: null removes nothing, as there is no such entry; {meant(str(name), others)}"


def doubtful_entries(path: str | Path) -> list[str]:
    """A line for what Snakemake takes from a configuration without a word, though it is probably not meant.

    These are keys that a section has twice, of which YAML takes the last, and numbers such as 010, which YAML reads
    as 8.
    """
    try:
        return parse_yaml(path, ADVICE)[1]
    except InputError:  # Snakemake has read it
        return []


def shipped_default() -> dict:
    """The default study where no clone is near: what config/config.yaml has, from the library's resources."""
    study = default_study()
    noise = {"model": "astra", "levels": study["levels"]}
    sections = {key: study[key] for key in ("grid", "scan", "protocols", "analyses")}
    return {"phantom": {"source": "synthetic"}, **sections, "noise": noise}


def _rendered(text: str) -> dict:
    """A configuration that is a YTE template, as Snakemake renders it."""
    try:
        import yte  # Snakemake installs it
    except ImportError:
        raise InputError(
            "__use_yte__: this configuration is a template, and yte is not installed; install Snakemake"
        ) from None
    with refusing("__use_yte__: this template cannot be rendered", Exception, advice="correct it"):
        return yte.process_yaml(text, require_use_yte=True)


def _updated(settings: Mapping, own: Mapping) -> dict:
    """As snakemake.utils.update_config: sections are merged, anything else is replaced."""
    merged = copy.deepcopy(dict(settings))
    for key, value in own.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = _updated(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged
