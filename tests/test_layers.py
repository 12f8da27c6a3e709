"""The library's packages have layers: imports point downwards and form no cycle."""

import ast
from graphlib import TopologicalSorter

import pytest

from virtual_phantom.config.dependencies import LIBRARY, imported

# Lowest first. A package imports from itself and from packages before it.
PACKAGES = (
    *("base", "io", "phantom", "projectors", "reconstruction", "physics", "simulation", "features", "image_model"),
    *(
        "statistics",
        "recordings",
        "diagnosis",
        "image_quality",
        "figures",
        "report",
        "proof",
        "config",
        "study",
        "cli",
        "api",
    ),
)
# Packages and modules directly inside a package, lowest first.
INSIDE = {
    "diagnosis": (
        *(
            "settings",
            "request",
            "workload",
            "result_files",
            "scanned_object",
            "noise",
            "fitting",
            "candidate_effects",
            "residuals",
            "uncertainty",
        ),
        *("verdict_text", "projections", "selection", "comparison", "images", "verdict", "features", "preparation"),
        *("assumptions", "setup", "run", "scanner", "planning"),
    ),
}
LARGEST_PACKAGE = 12  # modules of a package inside `diagnosis`, few enough for an overview


def modules():
    return sorted(path for path in LIBRARY.rglob("*.py") if path.parent != LIBRARY)


def unit(path, depth):
    """Name of the package or module of a path, `depth` folders down."""
    return path.relative_to(LIBRARY).parts[depth].removesuffix(".py")


def imports(path):
    """Library modules that a module imports, without the __init__ files on the way to them."""
    return [other for other in imported(path) if other.name != "__init__.py"]


def upwards(order, depth, paths):
    return [
        f"{path.relative_to(LIBRARY)} imports {other.relative_to(LIBRARY)}"
        for path in paths
        for other in imports(path)
        if other in paths and order.index(unit(other, depth)) > order.index(unit(path, depth))
    ]


def test_every_module_is_in_a_package():
    assert {unit(path, 0) for path in modules()} == set(PACKAGES)
    assert [path.name for path in LIBRARY.glob("*.py")] == ["__init__.py"]


def test_no_import_points_upwards():
    assert not upwards(PACKAGES, 0, modules())


@pytest.mark.parametrize("package", INSIDE)
def test_no_import_points_upwards_inside_a_package(package):
    inside = [path for path in modules() if unit(path, 0) == package and path != LIBRARY / package / "__init__.py"]
    assert {unit(path, 1) for path in inside} == set(INSIDE[package])
    assert not upwards(INSIDE[package], 1, inside)


def test_packages_inside_the_diagnosis_are_small():
    folders = {path.parent for path in modules() if unit(path, 0) == "diagnosis"}
    assert not [folder for folder in folders if len(set(folder.glob("*.py"))) > LARGEST_PACKAGE + 1]  # and __init__


def test_no_import_forms_a_cycle():
    """Also within packages; raises graphlib.CycleError, which names the modules."""
    TopologicalSorter({path: imports(path) for path in modules()}).prepare()


def test_library_does_not_import_snakemake():
    for path in LIBRARY.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not [name for name in names if name.split(".")[0].startswith("snakemake")], path
