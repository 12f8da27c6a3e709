"""Every benchmark imports, and `python -m benchmarks` lists and runs them."""

import importlib
import importlib.util
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import __main__ as benchmarks
from benchmarks import lacking
from benchmarks.common.simulator_scans import OF_OBJECT, left_to_do

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = benchmarks.scenarios()
OPTIONAL = {"gpu": "astra"}  # packages that the workflow does not need


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_has_options_and_a_run(name):
    if name in OPTIONAL and importlib.util.find_spec(OPTIONAL[name]) is None:
        pytest.skip(f"{OPTIONAL[name]} is not installed")
    module = importlib.import_module(f"benchmarks.{name}")
    assert callable(module.run)
    assert benchmarks.build_parser(name, module).format_help()


def test_only_scenarios_with_one_thread_limit_threads(monkeypatch):
    environment = {}
    monkeypatch.setattr(benchmarks, "os", SimpleNamespace(environ=environment))
    benchmarks.limit_threads(SCENARIOS["gpu"])
    assert not environment
    benchmarks.limit_threads(SCENARIOS["shapes"])
    assert environment == dict.fromkeys(benchmarks.THREAD_VARIABLES, "1")


def test_small_scans_hide_no_fault_of_the_object():
    """Their simulator rejects such faults, because their objects cannot change."""
    options = benchmarks.build_parser("lacking", lacking).parse_args("--seed 62 --unknown 60 --out none".split())
    truths = left_to_do(options, []).values()
    hidden = {effect["name"] for truth in truths for effect in truth["effects"]}
    assert len(truths) == 60 and len(hidden) > 8 and not hidden & {*OF_OBJECT}


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "benchmarks", *arguments], cwd=ROOT, capture_output=True, text=True)


def test_list_has_a_line_with_the_time_of_each_scenario(capsys):
    assert benchmarks.main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == sorted(SCENARIOS)
    assert all(line.endswith(").") for line in lines)


def test_scenario_runs_under_its_name_with_hyphens(tmp_path):
    out = tmp_path / "nothing.csv"
    done = run("run", "kinds-of-change", "--maker", "chain", "--draws", "1", "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert "p below 0.01: 0 of 1" in done.stdout and out.read_text().startswith("maker,draw,kind,z,p,gain\nchain,0,")


def test_unknown_scenario_and_missing_options_exit_with_a_message():
    assert "`list` prints the names" in run("run", "nonsense").stderr
    done = run("run", "intervals")
    assert done.returncode == 1 and done.stderr == "--seed and --out are missing; give both, or --count\n"
