"""Which files of the workflow and the library a job depends on: Snakemake does not follow imports."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from ..base.data import RESOURCES

LIBRARY = Path(__file__).resolve().parents[1]
TEMPLATES = "templates"  # folder beside the modules that fill them in
# They word mistakes and write logs; no result depends on them.
WITHOUT_EFFECT = (("base", "errors"), ("study", "job"))


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

    Parameters
    ----------
    script : str or Path

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
    return sorted(found | {page for path in found for page in (path.parent / TEMPLATES).glob("*.j2")})


@cache
def imported(path: Path) -> tuple[Path, ...]:
    """The library's files that one file imports itself."""
    inside = LIBRARY in path.parents
    package = path.relative_to(LIBRARY).parts[:-1] if inside else ()
    modules: set[tuple[str, ...]] = set()
    for node in _statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            modules |= {tuple(name.split(".")[1:]) for name in names if name.split(".")[0] == LIBRARY.name}
        elif isinstance(node, ast.ImportFrom):
            parts = tuple(filter(None, (node.module or "").split(".")))
            if node.level:
                parts = package[: len(package) - node.level + 1] + parts
            elif parts[:1] == (LIBRARY.name,):
                parts = parts[1:]
            else:
                continue
            modules |= {parts} | {(*parts, alias.name) for alias in node.names}
    return tuple(file for module in sorted(modules) for file in _files(module))


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    """All statements within a node; expressions, of which there are far more, hold no imports."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield child
            yield from _statements(child)


def _files(module: tuple[str, ...]) -> list[Path]:
    """A module's file and the __init__ of each package around it; nothing if the last name is no module."""
    if module in WITHOUT_EFFECT:
        return []
    place = LIBRARY.joinpath(*module)
    candidates = [place.with_suffix(".py")] if module else []
    candidates += [LIBRARY.joinpath(*module[: depth + 1], "__init__.py") for depth in range(len(module))]
    return [file for file in candidates if file.is_file()]
