"""The files behind a script are those that Python really loads for it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from virtual_phantom.config.dependencies import LIBRARY, WITHOUT_EFFECT, files_behind, imported

SCRIPTS = LIBRARY.parents[1] / "scripts"


@pytest.mark.parametrize(
    "module",
    ["reconstruction.images", "physics.scenes.line_integrals", "phantom.ct", "statistics.pca", "recordings.summary"],
)
def test_no_loaded_module_is_missed(module, tmp_path):
    """Against the modules that an interpreter holds after the import."""
    script = tmp_path / "script.py"
    script.write_text(f"import virtual_phantom.{module}\n")
    report = (
        "import sys; print(*(m.__file__ for n, m in sys.modules.items() if n.startswith('virtual_phantom')), sep='\\n')"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", f"{script.read_text()}\n{report}"],
        env={"PYTHONPATH": str(LIBRARY.parent)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    expected = {Path(file) for file in loaded} - {LIBRARY / "__init__.py"}
    expected -= {LIBRARY.joinpath(*module).with_suffix(".py") for module in WITHOUT_EFFECT}
    assert expected and expected <= set(files_behind(script))


def test_imports_inside_a_script_and_inside_functions_count():
    names = {file.name for file in files_behind(SCRIPTS / "reconstruct.py")}
    assert {"reconstruct.py", "acquire.py", "lanes.py", "astra_cuda.py", "cpu.py", "volumes.py"} <= names
    assert not {"extraction.py", "wilcoxon.py", "errors.py"} & names


def test_templates_count_with_the_pages_that_they_make():
    names = {file.name for file in files_behind(SCRIPTS / "viewer.py")}
    assert {"viewer.html.j2", "viewer.js.j2", "html.py"} <= names
    assert not [file for file in files_behind(SCRIPTS / "reconstruct.py") if file.suffix == ".j2"]


def named(path):
    """The library's modules that a file imports, as Python parses it: names below virtual_phantom."""
    package = path.relative_to(LIBRARY.parent).parts[:-1] if LIBRARY in path.parents else ()
    modules = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            around = package[: len(package) - node.level + 1] if node.level else ()
            parts = (*around, *filter(None, (node.module or "").split(".")))
            modules |= {parts} | {(*parts, alias.name) for alias in node.names}
    return {module[1:] for module in modules if module[:1] == (LIBRARY.name,)} - set(WITHOUT_EFFECT)


@pytest.mark.parametrize("folder", [LIBRARY, SCRIPTS], ids=["library", "scripts"])
def test_imports_are_those_that_python_parses(folder):
    for path in folder.rglob("*.py"):
        expected = set()
        for module in named(path):
            packages = [LIBRARY.joinpath(*module[:depth], "__init__.py") for depth in range(1, len(module) + 1)]
            expected |= {*packages, LIBRARY.joinpath(*module).with_suffix(".py")}
        assert set(imported(path)) == {file for file in expected if file.is_file()}, path
