"""Forbidden in the workflow's code: unpickling, evaluation of text, unsafe YAML, and shells."""

import ast
import re
from pathlib import Path

import pytest

from virtual_phantom.recordings.public_scans import fetch

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(
    path for folder in ("workflow", "docs", "benchmarks") for path in (ROOT / folder).rglob("*.py") if path.is_file()
)
RULES = [ROOT / "workflow" / "Snakefile", *sorted((ROOT / "workflow" / "rules").glob("*.smk"))]
IMPORTS = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "subprocess", "xml", "lxml"}
CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.load", "yaml.full_load"}
CALLS |= {"yaml.unsafe_load", "pandas.read_pickle", "pd.read_pickle", "nibabel.load", "pandas.read_xml", "pd.read_xml"}


# The only files that start other programs, s5cmd and Git, with a list of arguments.
STARTS_A_PROGRAM = ("public_scans/fetch.py", "scoring/registration.py")
# The only file that unpickles: compiled code, as Numba's own cache does. Its folders are writable only by the user and
# the installer of the package (tests/test_compiled.py), and its checksum must be correct.
READS_COMPILED_CODE = "base/compiled.py"


def name_of(node) -> str:
    return ast.unparse(node) if isinstance(node, ast.Name | ast.Attribute) else ""


def test_source_files_are_found():
    assert len(SOURCES) > 150 and len(RULES) > 10


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_code_is_executed_from_data(path):
    # Benchmarks time whole runs; the programs that they start are not the user's.
    starts = path.is_relative_to(ROOT / "benchmarks") or path.as_posix().endswith(STARTS_A_PROGRAM)
    compiled = path.as_posix().endswith(READS_COMPILED_CODE)
    banned = IMPORTS - ({"subprocess"} if starts else {"pickle"} if compiled else set())
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not banned & {alias.name.split(".")[0] for alias in node.names}, node.lineno
        if isinstance(node, ast.ImportFrom) and not node.level:
            assert (node.module or "").split(".")[0] not in banned, node.lineno
        if not isinstance(node, ast.Call):
            continue
        name, keywords = name_of(node.func), {keyword.arg: keyword.value for keyword in node.keywords}
        assert name not in CALLS, f"{name}, line {node.lineno}"
        assert "shell" not in keywords, node.lineno
        if name in ("np.load", "numpy.load"):
            assert ast.unparse(keywords["allow_pickle"]) == "False", node.lineno
        if name in ("loadmat", "scipy.io.loadmat"):
            assert "variable_names" in keywords, node.lineno


def test_only_compiled_code_with_a_correct_checksum_is_unpickled():
    (path,) = [path for path in SOURCES if path.as_posix().endswith(READS_COMPILED_CODE)]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and name_of(node.func).startswith("pickle.")]
    assert [ast.unparse(call) for call in calls] == ["pickle.loads(payload)"]
    (read,) = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "_read"]
    returned = {ast.unparse(node) for node in ast.walk(read) if isinstance(node, ast.Return)}
    assert returned == {"return None", "return payload if checksum == CHECKSUM(key + payload).digest() else None"}


@pytest.mark.parametrize("end, program", zip(STARTS_A_PROGRAM, ("run", "'git'"), strict=True))
def test_programs_are_started_with_a_list_of_arguments(end, program):
    (path,) = [path for path in SOURCES if path.as_posix().endswith(end)]
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    (started,) = [call for call in calls if name_of(call.func).startswith("subprocess.")]
    assert name_of(started.func) == "subprocess.run" and isinstance(started.args[0], ast.List)
    assert ast.unparse(started.args[0].elts[0]) == program
    assert fetch.PROGRAM == "s5cmd"


@pytest.mark.parametrize("path", RULES, ids=lambda path: path.name)
def test_rules_run_scripts_and_no_shell(path):
    assert not re.search(r"^\s*(shell|run)\s*:", path.read_text(encoding="utf-8"), re.MULTILINE)
