"""Which files of the workflow and the library a job depends on: Snakemake does not follow imports."""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path

from ..base.data import RESOURCES

LIBRARY = Path(__file__).resolve().parents[1]
TEMPLATES = "templates"  # folder beside the modules that fill them in
# They word mistakes, write logs, and say how long a job takes and how far it is; no result depends on them.
WITHOUT_EFFECT = (
    *(("base", "errors"), ("study", "job")),
    *(("study", "costs", "forecast"), ("study", "progress", "said"), ("diagnosis", "selection", "progress")),
)
# An import; each has lines of its own. Every start of the workflow reads hundreds of files, and a parser is slower.
IMPORT = re.compile(
    r"^[ \t]*(?:import[ \t]+(?P<names>[^\n#]+)"
    r"|from[ \t]+(?P<dots>\.*)(?P<module>[\w.]*)[ \t]+import[ \t]+(?P<taken>\([^)]*\)|[^\n#(]+))",
    re.MULTILINE,
)


def shipped(path: str | Path) -> str:
    """A file of the workflow as an input of a job. Relative, so that a moved folder stays valid."""
    return os.path.relpath(path)


def resource(name: str) -> str:
    """A table or a layout that comes with the library, as an input."""
    return shipped(RESOURCES / name)


def effect_code(*effects: str) -> list[str]:
    """The files of effects and what is behind them, as inputs."""
    files = {path for name in effects for path in files_behind(LIBRARY / "physics" / "effects" / f"{name}.py")}
    return [shipped(path) for path in sorted(files)]


def hook_code() -> list[str]:
    """The files of the proof's callbacks, as inputs."""
    return sorted(map(shipped, (LIBRARY / "proof" / "conceal" / "hooks").glob("*.py")))


def files_behind(script: str | Path) -> list[Path]:
    """The script and every file of the library that it imports, directly or not; also in functions.

    With the templates of pages that lie beside them.

    Returns
    -------
    list of Path
        Sorted.
    """
    found: set[Path] = set()
    waiting = [Path(script).resolve()]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += imported(path)
    return sorted(found.union(*map(_templates, {path.parent for path in found})))


@cache
def _templates(folder: Path) -> tuple[Path, ...]:
    return tuple((folder / TEMPLATES).glob("*.j2"))


@cache
def imported(path: Path) -> tuple[Path, ...]:
    """The library's files that one file imports itself."""
    inside = LIBRARY in path.parents
    package = path.relative_to(LIBRARY).parts[:-1] if inside else ()
    modules: set[tuple[str, ...]] = set()
    for found in IMPORT.finditer(path.read_text(encoding="utf-8")):
        if found["names"]:
            names = [tuple(name.split(".")) for name in _names(found["names"])]
            modules |= {name[1:] for name in names if name[0] == LIBRARY.name}
            continue
        parts = tuple(filter(None, found["module"].split(".")))
        if level := len(found["dots"]):
            parts = package[: len(package) - level + 1] + parts
        elif parts[:1] == (LIBRARY.name,):
            parts = parts[1:]
        else:
            continue
        modules |= {parts} | {(*parts, name) for name in _names(found["taken"])}
    return tuple(file for module in sorted(modules) for file in _files(module))


def _names(listed: str) -> list[str]:
    """What an import names, without what it is called here."""
    listed = re.sub(r"#.*", "", listed).strip("() \t\n")
    return [name.split()[0] for name in listed.split(",") if name.strip()]


@cache
def _files(module: tuple[str, ...]) -> list[Path]:
    """A module's file and the __init__ of each package around it; nothing if the last name is no module."""
    if module in WITHOUT_EFFECT:
        return []
    place = LIBRARY.joinpath(*module)
    candidates = [place.with_suffix(".py")] if module else []
    candidates += [LIBRARY.joinpath(*module[: depth + 1], "__init__.py") for depth in range(len(module))]
    return [file for file in candidates if file.is_file()]
