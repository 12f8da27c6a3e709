"""Choosing an engine, and the GPU engine where there is a GPU."""

import astra
import numpy as np
import pytest
from scanner import SCANNER

from virtual_phantom import projectors
from virtual_phantom.errors import InputError
from virtual_phantom.geometry import Grid, helical
from virtual_phantom.projectors.astra_cuda import cone_vectors
from virtual_phantom.projectors.cpu import CpuProjector

needs_cuda = pytest.mark.skipif(not astra.use_cuda(), reason="ASTRA finds no CUDA device here")
GEOMETRY = helical(
    views=40,
    volume_height_mm=48,
    **SCANNER,
    columns=60,
    rows=16,
    column_pitch_mm=6.0,
    row_pitch_mm=6.0,
    column_offset_px=1.5,
    row_offset_px=-0.5,
)


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
    ],
)
def test_engine_that_can_do_the_work_is_taken(monkeypatch, cuda, engine, backprojector, expected):
    monkeypatch.setattr(astra, "use_cuda", lambda: cuda)
    assert projectors.choose_engine(engine, backprojector) == expected


def test_astra_cuda_that_cannot_do_the_work(monkeypatch):
    monkeypatch.setattr(astra, "use_cuda", lambda: False)
    with pytest.raises(InputError, match="needs a CUDA device"):
        projectors.choose_engine("astra_cuda", "voxel")
    with pytest.raises(InputError, match="no adjoint"):
        projectors.choose_engine("astra_cuda", "adjoint")


def test_where_the_device_is_not_looked_for_its_user_does(monkeypatch):
    """Jobs of a cluster that need no device read the configuration without one; ASTRA would end the process."""
    monkeypatch.setattr(astra, "use_cuda", lambda: False)
    assert projectors.choose_engine("astra_cuda", "voxel", look=False) == "astra_cuda"
    assert projectors.choose_engine("auto", "voxel", look=False) == "cpu"
    with pytest.raises(InputError, match="no adjoint"):
        projectors.choose_engine("astra_cuda", "adjoint", look=False)
    with pytest.raises(InputError, match="needs a CUDA device"):
        projectors.projector("astra_cuda", GEOMETRY, Grid((2, 2, 2), (1.0, 1.0, 1.0)))


def test_cone_vectors_describe_the_same_rays():
    vectors = cone_vectors(GEOMETRY)
    for view, row, column in ((0, 0, 0), (17, 15, 59), (39, 3, 40)):
        source, pixel = GEOMETRY.ray(view, row, column)
        theirs = vectors[view].reshape(4, 3)
        along = theirs[1] + (column - 29.5) * theirs[2] + (row - 7.5) * theirs[3]
        np.testing.assert_allclose(theirs[0], source, atol=1e-9)
        np.testing.assert_allclose(along, pixel, atol=1e-9)


@needs_cuda
@pytest.mark.gpu
def test_gpu_projects_as_the_cpu_does():
    grid = Grid((24, 48, 48), (2.0, 4.0, 4.0))
    z, y, x = grid.axes_mm()
    ball = np.exp(-(x**2 + y[:, None] ** 2 + (2 * z[:, None, None]) ** 2) / 2000).astype(np.float32)
    cpu = CpuProjector(GEOMETRY, grid)
    gpu = projectors.projector("astra_cuda", GEOMETRY, grid)
    ours = cpu.unpack_projections(cpu.forward(cpu.pack_volume(ball[None])))
    theirs = gpu.unpack_projections(gpu.forward(gpu.pack_volume(ball[None])))
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.005 * ours.max()
