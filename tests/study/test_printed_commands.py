"""Printed commands work when they are pasted, and options accept names with commas."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from virtual_phantom.base import commands
from virtual_phantom.base.errors import InputError
from virtual_phantom.cli.init.options import format_list, parse_list, parse_pairs

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", ["my study.yaml", "it's.yaml", "$HOME.yaml", "a;b & c.yaml", "Größe.yaml"])
def test_shell_reads_the_words_back(name):
    shown = commands.command_line("virtual-phantom", "check", Path("a folder") / name)
    read = subprocess.run(["bash", "-c", f"printf '%s\\n' {shown}"], capture_output=True, text=True, check=True)
    assert read.stdout.splitlines() == ["virtual-phantom", "check", f"a folder/{name}"]


@pytest.mark.parametrize("snakefile", [None, "Snakefile", "workflow/Snakefile"])
def test_snakemake_finds_a_snakefile(snakefile, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if snakefile:
        Path(snakefile).parent.mkdir(exist_ok=True)
        Path(snakefile).touch()
    shown = shlex.split(commands.snakemake("--cores", "2", "--configfile", "my study.yaml"))
    named = [] if snakefile else ["-s", str(ROOT / "workflow" / "Snakefile")]
    assert shown == ["snakemake", *named, "--cores", "2", "--configfile", "my study.yaml"]
    assert commands.missing_for_snakemake() is None


def test_without_a_clone_one_line_states_the_requirement(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(commands, "clone", lambda: None)
    assert commands.snakemake("--cores", "2") == "snakemake -s CLONE/workflow/Snakefile --cores 2"
    assert commands.missing_for_snakemake().startswith("The installed package has no workflow: clone the repository")
    monkeypatch.setattr(commands, "clone", lambda: ROOT)
    monkeypatch.setitem(sys.modules, "snakemake", None)
    monkeypatch.setattr(commands.importlib.util, "find_spec", lambda name: None)
    assert (
        commands.missing_for_snakemake()
        == f"Snakemake is not installed here: run `make setup` in {ROOT} and activate its .venv"
    )


@pytest.mark.parametrize(
    "values, names",
    [
        (["5,spleen"], ["5", "spleen"]),
        (["5", "spleen"], ["5", "spleen"]),
        (['"GTV, left",spleen'], ["GTV, left", "spleen"]),
        (["5", '"a, b", c', ""], ["5", "a, b", "c"]),
        (['"the ""old"" one"'], ['the "old" one']),
    ],
)
def test_lists_are_quoted_as_in_csv(values, names):
    assert parse_list(values, "--rois") == names
    assert parse_list([format_list(names)], "--rois") == names


@pytest.mark.parametrize(
    "values, pairs",
    [
        (["5=liver,1=spleen"], {"5": "liver", "1": "spleen"}),
        (['"GTV, left"=gtv', "5=liver"], {"GTV, left": "gtv", "5": "liver"}),
        (["dose=50 Gy=target"], {"dose=50 Gy": "target"}),
    ],
)
def test_pairs_are_quoted_as_in_csv(values, pairs):
    assert parse_pairs(values) == pairs and parse_pairs([format_list(pairs)]) == pairs


@pytest.mark.parametrize("value", ['"GTV, left', '5,"a', 'a"'])
def test_unclosed_quotation_mark_is_one_line(value):
    with pytest.raises(InputError, match="has a quotation mark that is not closed; close it, or double it"):
        parse_list([value], "--rois")
