"""Matched noise levels and their exchange between jobs."""

import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.study import matched_noise


def test_open_levels_are_filled_in(tmp_path):
    matched_noise.write_level({"A": 2.5e-6, "variance_hu2": 228.0}, tmp_path / "dose10.json")
    acquisitions = [
        {"noise": "dose10", "noise_level": None, "seed": 1},
        {"noise": "other", "noise_level": 1e-4, "seed": 1},
    ]
    resolved = matched_noise.resolve(acquisitions, [tmp_path / "dose10.json"])
    assert [one["noise_level"] for one in resolved] == [2.5e-6, 1e-4]
    assert acquisitions[0]["noise_level"] is None


@pytest.mark.parametrize("text", ["", "{}", '{"A": "x"}', "[1]", '{"A": 1e-6'])
def test_broken_level_is_named(tmp_path, text):
    (tmp_path / "low.json").write_text(text)
    with pytest.raises(InputError, match="low.json: is not a noise level"):
        matched_noise.read_level(tmp_path / "low.json")
