"""The library's rooms lie one above another: imports run downwards, and never in a circle."""

import ast
from graphlib import TopologicalSorter

from virtual_phantom.study.dependencies import LIBRARY, imported

# Lowest first. A room knows itself and those before it.
ROOMS = (
    *("base", "io", "phantom", "projectors", "reconstruction", "physics", "features", "statistics", "recordings"),
    *("diagnosis", "figures", "report", "proof", "study", "api"),
)


def modules():
    return sorted(path for path in LIBRARY.rglob("*.py") if path.parent != LIBRARY)


def room(path):
    return path.relative_to(LIBRARY).parts[0]


def imports(path):
    """The library's files that a module imports, without the __init__ files on the way to them."""
    return [other for other in imported(path) if other.name != "__init__.py"]


def test_every_module_is_in_a_room():
    assert {room(path) for path in modules()} == set(ROOMS)
    assert [path.name for path in LIBRARY.glob("*.py")] == ["__init__.py"]


def test_no_import_goes_up():
    upwards = [
        f"{path.relative_to(LIBRARY)} imports {other.relative_to(LIBRARY)}"
        for path in modules()
        for other in imports(path)
        if other.parent != LIBRARY and ROOMS.index(room(other)) > ROOMS.index(room(path))
    ]
    assert not upwards


def test_no_import_goes_in_a_circle():
    """Within rooms either; raises graphlib.CycleError, which names the modules."""
    TopologicalSorter({path: imports(path) for path in modules()}).prepare()


def test_the_library_knows_nothing_of_snakemake():
    for path in LIBRARY.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not [name for name in names if name.split(".")[0].startswith("snakemake")], path
