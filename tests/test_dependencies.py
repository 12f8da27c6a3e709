"""Dependencies of a script are the files that Python loads; their version follows the code and not the text."""

import ast
import os
import subprocess
from pathlib import Path

import pytest
import warm

from virtual_phantom.config import dependencies
from virtual_phantom.config.dependencies import LIBRARY, RESULT_NEUTRAL_MODULES, code_version, files_behind, imported

SCRIPTS = LIBRARY.parents[1] / "scripts"


@pytest.mark.parametrize(
    "module",
    ["reconstruction.images", "physics.scenes.line_integrals", "phantom.ct", "statistics.pca", "recordings.summary"],
)
def test_no_loaded_module_is_missed(module, tmp_path):
    """Compare with the modules of an interpreter after the import."""
    script, report = tmp_path / "script.py", tmp_path / "report.py"
    script.write_text(f"import virtual_phantom.{module}\n")
    report.write_text(
        "import script, sys\n"
        "print(*(m.__file__ for n, m in sys.modules.items() if n.startswith('virtual_phantom')), sep='\\n')\n"
    )
    loaded = subprocess.run(
        [warm.python(), report],
        env=os.environ | {"PYTHONPATH": str(LIBRARY.parent)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    expected = {Path(file) for file in loaded} - {LIBRARY / "__init__.py"}
    expected -= {LIBRARY.joinpath(*module).with_suffix(".py") for module in RESULT_NEUTRAL_MODULES}
    assert expected and expected <= set(files_behind(script))


def test_result_neutral_modules_exist():
    assert all(LIBRARY.joinpath(*module).with_suffix(".py").is_file() for module in RESULT_NEUTRAL_MODULES)


def test_imports_inside_a_script_and_inside_functions_count():
    names = {file.name for file in files_behind(SCRIPTS / "reconstruct.py")}
    assert {"reconstruct.py", "acquire.py", "lanes.py", "astra_cuda.py", "cpu.py", "volumes.py"} <= names
    assert not {"extraction.py", "wilcoxon.py", "errors.py"} & names


def test_templates_count_with_their_pages():
    names = {file.name for file in files_behind(SCRIPTS / "viewer.py")}
    assert {"viewer.html.j2", "viewer.js.j2", "html.py"} <= names
    assert not [file for file in files_behind(SCRIPTS / "reconstruct.py") if file.suffix == ".j2"]


def named(path):
    """Library modules that a file imports according to Python's parser: names below virtual_phantom."""
    package = path.relative_to(LIBRARY.parent).parts[:-1] if LIBRARY in path.parents else ()
    modules = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            around = package[: len(package) - node.level + 1] if node.level else ()
            parts = (*around, *filter(None, (node.module or "").split(".")))
            modules |= {parts} | {(*parts, alias.name) for alias in node.names}
    return {module[1:] for module in modules if module[:1] == (LIBRARY.name,)} - set(RESULT_NEUTRAL_MODULES)


@pytest.mark.parametrize("folder", [LIBRARY, SCRIPTS], ids=["library", "scripts"])
def test_imports_agree_with_pythons_parser(folder):
    for path in folder.rglob("*.py"):
        expected = set()
        for module in named(path):
            packages = [LIBRARY.joinpath(*module[:depth], "__init__.py") for depth in range(1, len(module) + 1)]
            expected |= {*packages, LIBRARY.joinpath(*module).with_suffix(".py")}
        assert set(imported(path)) == {file for file in expected if file.is_file()}, path


MODULE = '''"""Words."""

import math  # a comment


def area(radius: float, scale=1.0) -> float:
    """Return the area."""
    return scale * math.pi * radius**2
'''


@pytest.fixture
def version(tmp_path, monkeypatch):
    """Version of a module with this text, from a separate cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    forget()

    def of(text):
        path = tmp_path / "module.py"
        path.write_text(text)
        forget()
        return code_version(path)

    yield of
    forget()


def forget():
    for function in (dependencies._cache, dependencies._parsed, imported, files_behind):
        function.cache_clear()


@pytest.mark.parametrize(
    "old, new",
    [
        ("Words.", "Other words."),
        ("Return the area.", "The area.\n\n    More.\n    "),
        ("# a comment", "# another"),
        ("scale * math.pi", "(scale  *\n        math.pi)"),
        ("import math", "\n\nimport math"),
    ],
)
def test_text_and_line_numbers_do_not_count(version, old, new):
    assert old in MODULE
    assert version(MODULE.replace(old, new)) == version(MODULE)


@pytest.mark.parametrize(
    "old, new",
    [
        ("1.0", "1"),
        ("1.0", "None"),
        ("**2", "**3"),
        ("import math", "import cmath as math"),
        ("scale *", "-scale *"),
        ('"""Return the area."""', '"""Return the area."""\n    "not a docstring"'),
        ("radius: float", "radius"),
    ],
)
def test_code_counts(version, old, new):
    assert old in MODULE
    assert version(MODULE.replace(old, new)) != version(MODULE)


def test_imported_modules_count(version, monkeypatch):
    imports = MODULE + "\nfrom virtual_phantom.base import geometry\n"
    before = version(imports)
    changed = (LIBRARY / "base" / "geometry.py").read_bytes() + b"\nEND = 1\n"
    read_bytes = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: changed if path.match("base/geometry.py") else read_bytes(path)
    )
    assert version(imports) != before


def test_effects_and_hooks_imported_by_name_count():
    script = SCRIPTS / "project.py"
    alone = code_version(script)
    assert len({alone, code_version(script, ["scatter"]), code_version(script, hooks=True)}) == 3
    assert code_version(script, ["scatter", "motion"]) == code_version(script, ["motion", "scatter"])


@pytest.mark.parametrize("content", ["", "[]", '{"a', None])
def test_damaged_or_missing_cache_changes_nothing(version, tmp_path, content, monkeypatch):
    before = version(MODULE)
    (file,) = (tmp_path / "cache" / "virtual_phantom").glob("code-*.json")
    if content is None:
        monkeypatch.setattr(dependencies, "_cache_file", lambda: None)
    else:
        file.write_text(content)
    assert version(MODULE) == before


def test_cached_file_is_not_parsed_again(version, monkeypatch):
    before = version(MODULE)
    monkeypatch.setattr(dependencies.ast, "parse", None)
    assert version(MODULE) == before
