"""Files of rules share one object, `context`, and no other name."""

import contextlib
import io
import re
import symtable

import pytest
from snakemake.api import SnakemakeApi
from snakemake.settings.types import OutputSettings, ResourceSettings
from workflow_runs import ROOT

FILES = [ROOT / "workflow" / "Snakefile", *sorted((ROOT / "workflow" / "rules").glob("*.smk"))]
SHARED = {"context"}


def compiled(path):
    """The Python that Snakemake makes of a file of rules."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text), SnakemakeApi(OutputSettings()) as api:
        api.workflow(resource_settings=ResourceSettings(), snakefile=path).print_compilation()
    return text.getvalue()


def scopes(table):
    """A table of symbols and all that lie in it: functions, lambdas, comprehensions."""
    yield table
    for inner in table.get_children():
        yield from scopes(inner)


def assigned(table):
    """Names that a file puts into the namespace that all files share: variables, functions, imports."""
    return {
        symbol.get_name()
        for scope in scopes(table)
        for symbol in scope.get_symbols()
        if (symbol.is_assigned() or symbol.is_imported()) and (scope is table or symbol.is_declared_global())
    }


def used(table):
    """Names that a file takes from there."""
    return {
        symbol.get_name()
        for scope in scopes(table)
        for symbol in scope.get_symbols()
        if symbol.is_referenced() and (scope is table or symbol.is_global())
    }


def borrowed(paths):
    """{file: names that it uses and that another file alone has assigned}."""
    tables = {path.name: symtable.symtable(compiled(path), path.name, "exec") for path in paths}
    names = {file: assigned(table) for file, table in tables.items()}
    found = {}
    for file, table in tables.items():
        others = set().union(*(one for other, one in names.items() if other != file))
        found[file] = (used(table) - names[file]) & others
    return found


def test_files_of_rules_share_the_context_and_nothing_else():
    found = borrowed(FILES)
    assert {file: names - SHARED for file, names in found.items() if names - SHARED} == {}
    assert sum(names == SHARED for names in found.values()) > 12


@pytest.mark.parametrize(
    "line",
    [
        "VALUE + 1",
        'f"{VALUE}/x"',
        "[one for one in VALUE]",
        "lambda wildcards: VALUE[wildcards.x]",
        "lambda wildcards, x=VALUE: x",
    ],
)
def test_a_name_of_another_file_is_found(line, tmp_path):
    (tmp_path / "one.smk").write_text("import os\nVALUE = os.sep\n")
    (tmp_path / "two.smk").write_text(f"rule x:\n    output: 'x'\n    params: y={line}\n    script: 'x.py'\n")
    paths = sorted(tmp_path.glob("*.smk"))
    assert borrowed(paths) == {"one.smk": set(), "two.smk": {"VALUE"}}


def test_paths_of_results_stand_in_the_table_alone():
    """Rules name outputs (study.outputs), and know neither results_dir nor a suffix of data."""
    for path in FILES:
        text = path.read_text()
        assert not re.search(r"results_dir|\.results\b", text), path.name
        assert not re.findall(r"\.(?:nii\.gz|h5|csv|json|html)\"", re.sub(r"(?:resource|schema)\(\".*?\"\)", "", text))
