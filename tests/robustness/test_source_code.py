"""What no code of the workflow does: unpickle, evaluate text, load unsafe YAML, or hand anything to a shell."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(
    path for folder in ("workflow", "docs", "benchmarks") for path in (ROOT / folder).rglob("*.py") if path.is_file()
)
RULES = [ROOT / "workflow" / "Snakefile", *sorted((ROOT / "workflow" / "rules").glob("*.smk"))]
IMPORTS = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "subprocess", "xml", "lxml"}
CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.load", "yaml.full_load"}
CALLS |= {"yaml.unsafe_load", "pandas.read_pickle", "pd.read_pickle", "nibabel.load", "pandas.read_xml", "pd.read_xml"}


def name_of(node) -> str:
    return ast.unparse(node) if isinstance(node, ast.Name | ast.Attribute) else ""


def test_there_is_something_to_look_at():
    assert len(SOURCES) > 150 and len(RULES) > 10


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_code_is_taken_from_data(path):
    # Benchmarks time whole runs; what they start is none of the user's.
    banned = IMPORTS - {"subprocess"} if path.parent.name == "benchmarks" else IMPORTS
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not banned & {alias.name.split(".")[0] for alias in node.names}, node.lineno
        if isinstance(node, ast.ImportFrom) and not node.level:
            assert (node.module or "").split(".")[0] not in banned, node.lineno
        if not isinstance(node, ast.Call):
            continue
        name, keywords = name_of(node.func), {one.arg: one.value for one in node.keywords}
        assert name not in CALLS, f"{name}, line {node.lineno}"
        assert "shell" not in keywords, node.lineno
        if name in ("np.load", "numpy.load"):
            assert ast.unparse(keywords["allow_pickle"]) == "False", node.lineno
        if name in ("loadmat", "scipy.io.loadmat"):
            assert "variable_names" in keywords, node.lineno


@pytest.mark.parametrize("path", RULES, ids=lambda path: path.name)
def test_rules_run_scripts_and_no_shell(path):
    assert not re.search(r"^\s*(shell|run)\s*:", path.read_text(encoding="utf-8"), re.MULTILINE)
