"""Cached fits of a diagnosis: their dependencies, and killed processes."""

import os
import signal

import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config import dependencies
from virtual_phantom.diagnosis.selection import trials as run_parallel
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.study import fit_cache_key as module
from virtual_phantom.study.fit_cache_key import fit_cache

MODEL = {"folder": "bench", "settings": {"samples": 2, "baseline": {"focal_spot": {"width_mm": {"value": 1, "sd": 0}}}}}


@pytest.fixture
def recording(tmp_path):
    for name in ("recording.yaml", "repeat_1.h5"):
        (tmp_path / name).write_text(name)
    return tmp_path


def made_of(folder, model=MODEL):
    return fit_cache(
        folder / "fits", from_mapping(FitSettings, model), [folder / "recording.yaml", folder / "repeat_1.h5"]
    ).made_of


@pytest.mark.parametrize("name", ["recording.yaml", "repeat_1.h5"])
def test_every_byte_of_the_recording_counts(recording, name):
    before = made_of(recording)
    assert made_of(recording) == before
    (recording / name).write_text(name[:-1] + "X")
    assert made_of(recording) != before


def test_settings_and_declared_physics_count(recording):
    before, settings = made_of(recording), MODEL["settings"]
    for changed in ({"samples": 3}, {"baseline": {}}, {"baseline": {"scatter": {}}}):
        assert made_of(recording, MODEL | {"settings": settings | changed}) != before


def change_code(monkeypatch, end):
    """Change the code of the modules whose paths end like this."""
    real = dependencies._parsed

    def parsed(path):
        version, imports = real(path)
        return ("other" if str(path).endswith(end) else version), imports

    monkeypatch.setattr(dependencies, "_parsed", parsed)


@pytest.mark.parametrize("changed", ["physics/effects/focal_spot.py", "physics/chain.py", "diagnosis/fitting/fit.py"])
def test_code_of_all_dependencies_counts(recording, monkeypatch, changed):
    before = made_of(recording)
    change_code(monkeypatch, changed)
    assert made_of(recording) != before


def test_code_of_effects_in_no_fit_does_not_count(recording, monkeypatch):
    before = made_of(recording)
    change_code(monkeypatch, "scatter.py")
    assert made_of(recording) == before


def test_versions_of_numerical_packages_count(recording, monkeypatch):
    before = made_of(recording)
    monkeypatch.setattr(module, "version", lambda name: "0.0.1" if name == "scipy" else "2.0")
    assert made_of(recording) != before


def test_killed_process_is_one_line(monkeypatch):
    """A process pool would wait for it forever."""
    monkeypatch.setattr(run_parallel, "trial", lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL))
    with pytest.raises(InputError, match="2 processes .* was killed, .* memory: run with fewer cores"):
        run_parallel.trials(None, [(("scatter",), None, None), (("motion",), None, None)], 2)
