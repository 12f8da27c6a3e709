"""A sample of benchmarks/fuzz_files.py: wrong headers are refused in one line, reported, or change nothing."""

import logging

import pytest

from benchmarks import fuzz_files


@pytest.mark.filterwarnings("ignore")  # of pydicom and numpy, about values that are wrong by intent
@pytest.mark.parametrize(("kind", "runs"), [("nifti", 120), ("rtstruct", 60), ("seg", 40)])
def test_no_header_ends_in_a_traceback_or_changes_the_phantom_in_silence(kind, runs, tmp_path, caplog):
    caplog.set_level(logging.CRITICAL, "pydicom")
    counts, faults = fuzz_files.FORMATS[kind](runs, 1, tmp_path)
    assert not faults
    assert counts["refused"] and counts["same"] and sum(counts.values()) == runs
    assert not any(counts[fault] for fault in fuzz_files.FAULTS)
