"""Versions of the code behind a script, so that Snakemake runs a job again if its code changes.

Snakemake does not follow the imports of a script. Each rule therefore has a parameter `code`: a hash of the script and
of all modules of the library that it imports, directly or indirectly. The hash covers the syntax tree without
docstrings, so that changed comments, docstrings or line breaks run nothing again.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from ..base.cache_folders import temporary_cache, user_cache
from ..base.data import RESOURCES

LIBRARY = Path(__file__).resolve().parents[1]
EFFECTS = LIBRARY / "physics" / "effects"
HOOKS = LIBRARY / "proof" / "hiding" / "hooks"
TEMPLATES = "templates"  # folder of page templates, next to the modules that use them
# Modules that word errors, write logs or report progress. No result depends on them.
RESULT_NEUTRAL_MODULES = (
    *(("base", "errors"), ("study", "job")),
    *(("study", "costs", "forecast"), ("study", "progress", "job_status"), ("diagnosis", "selection", "progress")),
)
MOST_PARSED = 5000  # files in the cache; the library and the scripts of one checkout are about 500
WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def shipped(path: str | Path) -> str:
    """Return the path of a file of the workflow as input of a job: relative, so that a moved folder stays valid."""
    return os.path.relpath(path)


def resource(name: str) -> str:
    """Return a table or layout of the library as input of a job."""
    return shipped(RESOURCES / name)


def code_version(script: str | Path, effects: Iterable[str] = (), hooks: bool = False) -> str:
    """Return a hash of the code that a script runs.

    Parameters
    ----------
    effects : iterable of str, optional
        Effects that the script uses. They are imported by name, so that no import statement shows them.
    hooks : bool, optional
        Add the callbacks of the blind validation, which the independent simulator imports by name.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    more = [effect_file(name) for name in effects]
    if hooks:
        more += HOOKS.glob("*.py")
    return code_hash(script, *more)


def effect_file(name: str) -> Path:
    """Return the module of an effect."""
    return EFFECTS / f"{name}.py"


def code_hash(*modules: str | Path) -> str:
    """Return a hash of 16 hexadecimal digits: of modules and everything they import from the library."""
    known = len(_cache())
    files = sorted({file for module in modules for file in files_behind(module)})
    # The hash includes the names of files in the library, so that moving a module changes it.
    versions = [(_relative(file), _parsed(file)[0]) for file in files]
    if len(_cache()) > known:
        _save()
    return hashlib.sha256(json.dumps(versions).encode()).hexdigest()[:16]


@cache
def _relative(path: Path) -> str:
    return path.relative_to(LIBRARY).as_posix() if LIBRARY in path.parents else path.name


@cache
def files_behind(script: str | Path) -> tuple[Path, ...]:
    """Return a script, all files of the library that it imports, and the page templates next to these files, sorted.

    Indirect imports and imports in functions are included.
    """
    found: set[Path] = set()
    waiting = [Path(script).resolve()]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += imported(path)
    return tuple(sorted(found.union(*map(_templates, {path.parent for path in found}))))


@cache
def _templates(folder: Path) -> tuple[Path, ...]:
    return tuple((folder / TEMPLATES).glob("*.j2"))


@cache
def imported(path: Path) -> tuple[Path, ...]:
    """Return the files of the library that one file imports directly."""
    inside = LIBRARY in path.parents
    package = path.relative_to(LIBRARY).parts[:-1] if inside else ()
    modules: set[tuple[str, ...]] = set()
    for level, module, names in _parsed(path)[1]:
        parts = tuple(filter(None, module.split(".")))
        if level:
            parts = package[: len(package) - level + 1] + parts
        elif parts[:1] == (LIBRARY.name,):
            parts = parts[1:]
        else:
            continue
        modules |= {parts} | {(*parts, name) for name in names}
    return tuple(sorted({file for module in modules for file in _files(module)}))


@cache
def _files(module: tuple[str, ...]) -> tuple[Path, ...]:
    """Return a module's file, if it is one, and the __init__ of each package around it; nothing if it is neutral."""
    if module in RESULT_NEUTRAL_MODULES:
        return ()
    candidates = [module, *((*module[: depth + 1], "__init__") for depth in range(len(module)))]
    return tuple(_library()[one] for one in candidates if one in _library())


@cache
def _library() -> dict[tuple[str, ...], Path]:
    """Return {parts of the path without suffix: path} of all modules. A listing is faster than thousands of checks."""
    return {path.relative_to(LIBRARY).with_suffix("").parts: path for path in LIBRARY.rglob("*.py")}


@cache
def _parsed(path: Path) -> tuple[str, list]:
    """Return a hash of a file's code and its imports, each as level, module and imported names."""
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    if path.suffix != ".py":
        return digest, []
    known = _cache()
    if digest not in known:
        tree = ast.parse(content)
        known[digest] = [hashlib.sha256(repr(_code(tree)).encode()).hexdigest(), _imports(tree)]
    version, imports = known[digest]
    return version, imports


def _code(node):
    """Return a syntax tree as nested tuples, without docstrings, positions and empty fields."""
    # Trees of one text differ in their empty fields between versions of Python; `ast.dump` would show them.
    if isinstance(node, ast.AST):
        fields = {name: value for name, value in ast.iter_fields(node) if value is not None and value != []}
        if isinstance(node, WITH_DOCSTRING) and ast.get_docstring(node, clean=False) is not None:
            fields["body"] = fields["body"][1:]
        return type(node).__name__, *((name, _code(value)) for name, value in fields.items())
    return tuple(map(_code, node)) if isinstance(node, list) else node


def _imports(tree: ast.Module) -> list:
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [[0, alias.name, []] for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append([node.level, node.module or "", [alias.name for alias in node.names]])
    return found


# The cache is {hash of a file's content: result of _parsed}. Without it, every start parses all files in two seconds.


def _cache_file() -> Path | None:
    base = user_cache() or temporary_cache()
    return base and base / f"code-{sys.version_info.major}.{sys.version_info.minor}.json"


@cache
def _cache() -> dict[str, list]:
    """Return the cache; empty if there is none, or if it is damaged or too large."""
    with contextlib.suppress(OSError, ValueError):
        if (path := _cache_file()) is not None:
            content = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(content, dict) and len(content) <= MOST_PARSED:
                return content
    return {}


def _save() -> None:
    """Write the cache; without a folder that can be written to, the next start parses the files again."""
    with contextlib.suppress(OSError):
        if (path := _cache_file()) is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor, name = tempfile.mkstemp(dir=path.parent)
            with open(descriptor, "w", encoding="utf-8") as file:
                json.dump(_cache(), file)
            os.replace(name, path)
