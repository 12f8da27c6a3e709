"""Notebooks run, and their stored output is current."""

import ast
import contextlib
import io
from pathlib import Path

import nbformat
import pytest

from virtual_phantom.recordings.importers.htc2022 import import_htc2022

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
CT = ROOT / "../shared/real/abdomen_ct"
NEEDS = {"own-ct": CT, "diagnosis": ROOT / "../shared/real/htc2022"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Folder with the input files of a notebook."""
    if CT.exists():
        (tmp_path / "resources").mkdir()
        (tmp_path / "resources" / "abdomen_ct").symlink_to(CT)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shown(source: str, names: dict) -> str:
    """Output of a cell, and the text of its last expression, as stored in a notebook."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        if value is not None:
            print(repr(value))
    return printed.getvalue()


def firsts(text: str) -> list[str]:
    """First word of every line."""
    return [line.split()[0] for line in text.splitlines() if line.strip()]


@pytest.mark.filterwarnings("ignore::virtual_phantom.features.extraction.RadiomicsWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_its_stored_output_is_current(path, folder):
    """The last digits depend on the processor: the first word of every printed line is compared."""
    needed = NEEDS.get(path.stem)
    if needed is not None and not needed.exists():
        pytest.skip(f"needs {needed.name} among the real measurements")
    if path.stem == "diagnosis":
        import_htc2022(needed / "htc2022_solid_disc_full.mat", folder / "recordings" / "solid_disc")
    names: dict = {}
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type != "code":
            continue
        found = shown(cell.source, names)
        stored = "".join(output.get("text") or output["data"]["text/plain"] for output in cell.outputs)
        assert cell.execution_count and stored, cell.source
        if "Figure" not in stored:
            assert firsts(found) == firsts(stored)
