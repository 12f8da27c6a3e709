"""A sample of benchmarks/fuzz_files.py: wrong headers are rejected in one line, reported, or change nothing."""

import logging

import pytest

from benchmarks import fuzz_files


@pytest.mark.filterwarnings("ignore")  # from pydicom and numpy about values that are wrong on purpose
@pytest.mark.parametrize(("kind", "runs"), [("nifti", 120), ("rtstruct", 60), ("seg", 40)])
def test_wrong_headers_give_no_traceback_and_no_silent_change(kind, runs, tmp_path, caplog):
    caplog.set_level(logging.CRITICAL, "pydicom")
    counts, faults = fuzz_files.FORMATS[kind](runs, 1, tmp_path)
    assert not faults
    assert counts["refused"] and counts["same"] and sum(counts.values()) == runs
    assert not any(counts[fault] for fault in fuzz_files.FAULTS)
