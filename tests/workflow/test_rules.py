"""Rule files share only the names of common.smk and state the paths of the table of outputs."""

import contextlib
import io
import re
import symtable

import pytest
from snakemake.api import SnakemakeApi
from snakemake.settings.types import OutputSettings, ResourceSettings
from workflow_runs import ROOT

from virtual_phantom.config.outputs import OUTPUTS, PCA, PICTURES

FILES = [ROOT / "workflow" / "Snakefile", *sorted((ROOT / "workflow" / "rules").glob("*.smk"))]
SHARED = {"named", "context", "results", "reported", "code", "resource", "to_mapping"}


def compiled(path):
    """Python code that Snakemake makes of a file of rules."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text), SnakemakeApi(OutputSettings()) as api:
        api.workflow(resource_settings=ResourceSettings(), snakefile=path).print_compilation()
    return text.getvalue()


def scopes(table):
    """A symbol table and all tables inside: functions, lambdas, comprehensions."""
    yield table
    for inner in table.get_children():
        yield from scopes(inner)


def assigned(table):
    """Names that a file adds to the common namespace: variables, functions, imports."""
    return {
        symbol.get_name()
        for scope in scopes(table)
        for symbol in scope.get_symbols()
        if (symbol.is_assigned() or symbol.is_imported()) and (scope is table or symbol.is_declared_global())
    }


def used(table):
    """Names that a file uses from the common namespace."""
    return {
        symbol.get_name()
        for scope in scopes(table)
        for symbol in scope.get_symbols()
        if symbol.is_referenced() and (scope is table or symbol.is_global())
    }


def borrowed(paths):
    """{file: names that it uses and that only another file has assigned}."""
    tables = {path.name: symtable.symtable(compiled(path), path.name, "exec") for path in paths}
    names = {file: assigned(table) for file, table in tables.items()}
    found = {}
    for file, table in tables.items():
        others = set().union(*(one for other, one in names.items() if other != file))
        found[file] = (used(table) - names[file]) & others
    return found


def test_rule_files_share_the_names_of_common_smk_only():
    found = borrowed(FILES)
    assert {file: names - SHARED for file, names in found.items() if names - SHARED} == {}
    assert set().union(*found.values()) == SHARED
    assert sum("results" in names for names in found.values()) > 12


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
def test_name_of_another_file_is_found(line, tmp_path):
    (tmp_path / "one.smk").write_text("import os\nVALUE = os.sep\n")
    (tmp_path / "two.smk").write_text(f"rule x:\n    output: 'x'\n    params: y={line}\n    script: 'x.py'\n")
    paths = sorted(tmp_path.glob("*.smk"))
    assert borrowed(paths) == {"one.smk": set(), "two.smk": {"VALUE"}}


def stated():
    """Paths below results_dir that rules state, without logs and benchmarks; names in f-strings are wildcards."""
    texts = [text for path in FILES for text in re.findall(r'(?:results|reported)\((f?"[^"]+")\)', path.read_text())]
    assert len(texts) > 150
    paths = {text.removeprefix("f").strip('"').replace("{{", "{").replace("}}", "}") for text in texts}
    return {path for path in paths if not re.search(r"^logs$|\.log$|\.benchmark\.tsv$", path)}


def rows(paths):
    """Paths with every wildcard as *."""
    return {re.sub(r"\{[^}]+\}", "*", path) for path in paths}


def test_paths_of_rules_are_those_of_the_table():
    table = rows(path for output in OUTPUTS for path in output.paths())
    rule_paths = rows(stated())
    # An input whose wildcard has one value, and figures that the table lists by name.
    pictures = {"figures/pca_*.png", "figures/pca_*.pdf"}
    assert rule_paths - table == {"logs/kernels/project_1.txt", "projections/*/*.h5"} | pictures
    functions = {"proof/verdicts/*.json", "*.parquet"}  # lists made by the context
    scans = {"projections/*/clean.h5", "projections/*/clean_**.h5"}  # {scan} of the rule project
    assert table - rule_paths == functions | scans | {
        f"figures/pca_{name}{suffix}" for name in PCA for suffix in PICTURES
    }


def test_rules_do_not_contain_the_results_folder():
    for path in FILES:
        assert not re.search(r"results_dir|\.results\b", re.sub(r'"""(.|\n)*?"""', "", path.read_text())), path.name


def test_rules_expand_no_outputs_of_other_rules():
    """With a default storage (docs/how-to/cluster.md), Snakemake refuses `expand(rules.x.output)`."""
    assert not [path.name for path in FILES if "expand(rules." in path.read_text()]
