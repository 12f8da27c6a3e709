"""Results of a processor without newer instructions, from line integrals to features.

docs/reference/stability.md states the tolerances.
"""

import os
import subprocess
import sys

import numpy as np
import pytest
from processors import NOISE_LEVEL, plain_processor, small_scan
from processors import __file__ as script


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The scan by this processor, and by a plain x86-64 processor in a separate process."""
    folder = tmp_path_factory.mktemp("processor")
    environment = os.environ | plain_processor(folder / "kernels")
    command = [sys.executable, script, str(folder / "plain.npz")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return small_scan(), np.load(folder / "plain.npz")


def test_counts_of_equal_means_are_equal(both):
    here, there = both
    np.testing.assert_array_equal(here["means"], there["means"])
    np.testing.assert_array_equal(here["counts_of_means"], there["counts_of_means"])


def test_counts_of_a_scan_differ_by_one_where_means_differ(both):
    """As often as the means differ: a count changes with the probability of the difference."""
    here, there = both
    lines = here["lines"].astype(float), there["lines"].astype(float)
    assert np.abs(lines[0] - lines[1]).max() < 1e-5 * lines[0].max()
    means = [np.exp(-line / line.max()) / NOISE_LEVEL for line in lines]
    moved = np.abs(here["counts"].astype(int) - there["counts"])
    assert moved.max() <= 1
    expected = len(moved) * np.abs(means[0] - means[1]).sum()
    # All are divided by the largest line integral, whose error may change this share of all counts.
    assert moved.sum() < expected + 5 * np.sqrt(expected) + 5
    assert (moved == 0).mean() > 0.98


def test_images_and_features_agree(both):
    here, there = both
    off = np.abs(here["images"].astype(int) - there["images"])
    assert off.max() <= 1 and (off == 0).mean() > 0.99
    sd = here["features"].std(axis=0, ddof=1)
    known = sd > 1e-9 * np.abs(here["features"]).mean(axis=0)
    assert known.mean() > 0.9
    difference = np.abs(here["features"] - there["features"])[:, known] / sd[known]
    assert np.median(difference) < 1e-3 and np.quantile(difference, 0.99) < 0.1 and difference.max() < 1
