"""A sample of benchmarks/fuzz_files.py: wrong headers are refused in one line, reported, or change nothing."""

import importlib.util
import logging
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz_files.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("fuzz_files", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.filterwarnings("ignore")  # of pydicom and numpy, about values that are wrong by intent
@pytest.mark.parametrize(("kind", "runs"), [("nifti", 120), ("rtstruct", 60), ("seg", 40)])
def test_no_header_ends_in_a_traceback_or_changes_the_phantom_in_silence(kind, runs, script, tmp_path, caplog):
    caplog.set_level(logging.CRITICAL, "pydicom")
    counts, faults = script.FORMATS[kind](runs, 1, tmp_path)
    assert not faults
    assert counts["refused"] and counts["same"] and sum(counts.values()) == runs
    assert not any(counts[fault] for fault in script.FAULTS)
