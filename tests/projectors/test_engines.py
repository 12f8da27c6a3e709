"""Choosing an engine."""

from dataclasses import replace

import astra
import pytest
from scanner import SCANNER

from benchmarks import common
from virtual_phantom import projectors
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular

GEOMETRY = circular(views=4, **SCANNER, columns=6, rows=2, column_pitch_mm=6.0, row_pitch_mm=6.0)
GRID = Grid((2, 2, 2), (1.0, 1.0, 1.0))


def test_unknown_engine():
    with pytest.raises(InputError, match="engine 'gpu' is unknown"):
        projectors.choose_engine("gpu", "voxel")


@pytest.mark.parametrize(
    "cuda, engine, backprojector, expected",
    [
        (False, "auto", "adjoint", "cpu"),
        (False, "auto", "voxel", "cpu"),
        (True, "auto", "voxel", "astra_cuda"),
        (True, "auto", "adjoint", "cpu"),
        (True, "cpu", "voxel", "cpu"),
        (True, "astra_cuda", "voxel", "astra_cuda"),
        (True, "astra_cuda", None, "astra_cuda"),
        (True, "auto", None, "astra_cuda"),
        (False, "auto", None, "cpu"),
    ],
)
def test_suitable_engine_is_chosen(monkeypatch, cuda, engine, backprojector, expected):
    monkeypatch.setattr(astra, "use_cuda", lambda: cuda)
    monkeypatch.setattr(projectors, "cupy_installed", lambda: True)
    assert projectors.choose_engine(engine, backprojector) == expected


@pytest.mark.parametrize(
    "needs, message",
    [
        ({"backprojector": "voxel", "flat": False}, "SIRT on astra_cuda needs flat detectors and divergent beams"),
        ({"backprojector": "adjoint"}, "no adjoint"),
        ({"normalise": "none"}, "no FDK"),
        ({"normalise": "coverage", "flat": False}, None),
    ],
)
def test_engine_supports_the_algorithms_that_are_used(monkeypatch, needs, message):
    """FBP on the device supports all detectors; only SIRT depends on ASTRA."""
    monkeypatch.setattr(astra, "use_cuda", lambda: True)
    monkeypatch.setattr(projectors, "cupy_installed", lambda: True)
    assert projectors.choose_engine("auto", **needs) == ("cpu" if message else "astra_cuda")
    if message:
        with pytest.raises(InputError, match=message):
            projectors.choose_engine("astra_cuda", **needs)
    else:
        assert projectors.choose_engine("astra_cuda", **needs) == "astra_cuda"


def test_study_needs_an_engine_for_its_algorithms():
    study = common.configuration()
    curved = replace(study.scan, detector="cylindrical")
    by = {
        algorithm: {name: one for name, one in study.protocols.items() if one.algorithm == algorithm}
        for algorithm in ("sirt", "fbp")
    }
    both = {"backprojector": "adjoint", "normalise": "coverage", "flat": True}
    assert study.engine_needs == both
    assert replace(study, protocols=by["fbp"]).engine_needs == both | {"backprojector": None}
    assert replace(study, protocols=by["sirt"]).engine_needs == both | {"normalise": None}
    assert replace(study, scan=curved).engine_needs == both | {"flat": False}


def test_unsuitable_astra_cuda_is_rejected(monkeypatch):
    monkeypatch.setattr(astra, "use_cuda", lambda: False)
    with pytest.raises(InputError, match="needs a CUDA device"):
        projectors.choose_engine("astra_cuda", "voxel")
    with pytest.raises(InputError, match="no adjoint"):
        projectors.choose_engine("astra_cuda", "adjoint")


def test_device_is_checked_by_the_job_that_uses_it(monkeypatch):
    """Jobs of a cluster that need no device read the configuration without one; ASTRA would end the process."""
    monkeypatch.setattr(astra, "use_cuda", lambda: False)
    assert projectors.choose_engine("astra_cuda", "voxel", check=False) == "astra_cuda"
    assert projectors.choose_engine("auto", "voxel", check=False) == "cpu"
    with pytest.raises(InputError, match="no adjoint"):
        projectors.choose_engine("astra_cuda", "adjoint", check=False)
    with pytest.raises(InputError, match="needs a CUDA device"):
        projectors.projector("astra_cuda", GEOMETRY, GRID)


def test_device_without_cupy(monkeypatch):
    """`auto` reports why it does not use the device; `astra_cuda` stops."""
    monkeypatch.setattr(astra, "use_cuda", lambda: True)
    monkeypatch.setattr(projectors, "cupy_installed", lambda: False)
    with pytest.warns(UserWarning, match="pip install -r environment-gpu.txt"):
        assert projectors.choose_engine("auto", "voxel") == "cpu"
    with pytest.raises(InputError, match="needs CuPy, which cannot be imported: .*; or set engine: cpu"):
        projectors.choose_engine("astra_cuda", "voxel")
    with pytest.raises(InputError, match="needs CuPy"):
        projectors.projector("astra_cuda", GEOMETRY, GRID)
