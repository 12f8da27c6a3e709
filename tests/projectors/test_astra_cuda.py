"""GPU engine: parts that need no device, and agreement with the CPU engine on a device."""

from types import SimpleNamespace

import astra
import numpy as np
import pytest
from astra import experimental
from astra.log import AstraError
from on_device import OnDevice
from scanner import SCANNER

from virtual_phantom import projectors
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, helical
from virtual_phantom.base.settings import SirtSettings
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.projectors import astra_cuda
from virtual_phantom.projectors.astra_cuda import AstraCudaProjector, cone_vectors, projection_geometry, volume_geometry
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction import images, sirt

needs_cuda = pytest.mark.skipif(
    not (astra.use_cuda() and projectors.cupy_installed()), reason="ASTRA finds no CUDA device here, or no CuPy"
)
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
GRID = Grid((24, 48, 48), (2.0, 4.0, 4.0))
SIRT = defaults_of("reconstruction", "sirt")


def test_cone_vectors_describe_the_same_rays():
    vectors = cone_vectors(GEOMETRY)
    for view, row, column in ((0, 0, 0), (17, 15, 59), (39, 3, 40)):
        source, pixel = GEOMETRY.ray(view, row, column)
        theirs = vectors[view].reshape(4, 3)
        along = theirs[1] + (column - 29.5) * theirs[2] + (row - 7.5) * theirs[3]
        np.testing.assert_allclose(theirs[0], source, atol=1e-9)
        np.testing.assert_allclose(along, pixel, atol=1e-9)


@pytest.fixture
def device(monkeypatch):
    """Array module and ASTRA's two calls, computed by the CPU engine; `moved` counts transfers."""
    moved = {"to": 0, "from": 0}

    def asarray(array):
        moved["to"] += 1
        assert type(array) is np.ndarray and array.flags.c_contiguous and array.dtype == np.float32
        return OnDevice(array.copy())

    def asnumpy(array):
        moved["from"] += 1
        return array.held.copy()

    def zeros(shape, dtype):
        return OnDevice(np.zeros(shape, dtype))

    cpu = CpuProjector(GEOMETRY, GRID)
    shapes = {"-vol": GRID.shape, "-sino": (GEOMETRY.rows, GEOMETRY.views, GEOMETRY.columns)}
    linked = {}

    def link(kind, _, array):
        assert array.shape == shapes[kind] and array.held.flags.c_contiguous and array.held.dtype == np.float32
        linked[len(linked) + 1] = array.held
        return len(linked)

    def delete(numbers):
        for number in numbers:
            del linked[number]

    def forward(_, volumes, projections):
        packed = cpu.forward(cpu.pack_volume(linked[volumes[0]][None]))
        linked[projections[0]][...] = np.swapaxes(cpu.unpack_projections(packed)[0], 0, 1)

    def back(_, volumes, projections):
        taken = np.swapaxes(linked[projections[0]], 0, 1)
        found = cpu.unpack_volume(cpu.back(cpu.pack_projections(taken[None])))[0]
        linked[volumes[0]][...] = 1234.5 * found  # ASTRA has its own scale

    operations = SimpleNamespace(do_composite_FP=forward, do_composite_BP=back)
    monkeypatch.setattr(astra_cuda, "experimental", operations)
    monkeypatch.setattr(astra.data3d, "link", link)
    monkeypatch.setattr(astra.data3d, "delete", delete)
    yield SimpleNamespace(asarray=asarray, asnumpy=asnumpy, zeros=zeros, moved=moved)
    assert not linked, "ASTRA still holds arrays"


@pytest.mark.parametrize("solver", ["chebyshev", "plain"])
def test_data_stay_on_the_device_between_iterations(device, solver):
    """SIRT transfers the data once and the image back, for any number of iterations, and gives the CPU's image."""
    scan = np.random.default_rng(4).random((2, GEOMETRY.views, GEOMETRY.rows, GEOMETRY.columns), np.float32)
    moved = []
    for steps in (3, 9):
        device.moved.update({"to": 0, "from": 0})
        settings = {"iterations": 2 * steps, "terms": steps, "solver": solver, "backprojector": "voxel"}
        found = sirt.sirt(AstraCudaProjector(GEOMETRY, GRID, 2, arrays=device), scan, **settings)
        expected = sirt.sirt(CpuProjector(GEOMETRY, GRID, 2), scan, **settings)
        # Voxels that a single ray grazes take over its rounding error and have no bound.
        assert np.sqrt(np.mean((found - expected) ** 2)) < 1e-3 * expected.std()
        moved.append(dict(device.moved))
    assert moved[0] == moved[1] == {"to": 3, "from": 1}  # data, a volume and projections of ones; the image


def test_projectors_are_made_once_and_deleted(device, monkeypatch):
    made, deleted = [], []
    monkeypatch.setattr(astra, "create_projector", lambda kind, rays, volume: made.append(kind) or len(made))
    monkeypatch.setattr(astra.projector3d, "delete", deleted.append)
    projector = AstraCudaProjector(GEOMETRY, GRID, arrays=device)
    lines = projector.forward(projector.empty_volume())
    projector.back(lines)
    projector.back(lines)
    assert made == ["cuda3d"]
    del projector
    assert deleted == [1]


def test_failed_projection_raises_instead_of_returning_zeros(device, monkeypatch):
    """ASTRA's direct calls would return without an error."""
    projector = AstraCudaProjector(GEOMETRY, GRID, arrays=device)
    volume = projector.empty_volume()
    lines = projector.forward(volume)

    def fail(*_):
        raise AstraError("Failed to perform FP:\nout of memory")

    monkeypatch.setattr(astra_cuda, "experimental", SimpleNamespace(do_composite_FP=fail, do_composite_BP=fail))
    for fails in (lambda: projector.forward(volume), lambda: projector.back(lines)):
        with pytest.raises(InputError, match="astra_cuda: Failed to perform FP: out of memory; if the device's memory"):
            fails()


def test_astra_functions_exist():
    """ASTRA's `experimental` module may change between versions."""
    assert callable(experimental.do_composite_FP) and callable(experimental.do_composite_BP)
    number = astra.create_projector("cuda3d", projection_geometry(GEOMETRY), volume_geometry(GRID))
    astra.projector3d.delete(number)
    arrays = [np.zeros(GRID.shape, np.float32), np.zeros((GEOMETRY.rows, GEOMETRY.views, GEOMETRY.columns), np.float32)]
    linked = [
        astra.data3d.link("-vol", volume_geometry(GRID), arrays[0]),
        astra.data3d.link("-sino", projection_geometry(GEOMETRY), arrays[1]),
    ]
    arrays[1][3, 7, 5] = 2.5
    assert astra.data3d.get(linked[1])[3, 7, 5] == 2.5
    astra.data3d.delete(linked)


def test_realizations_are_transferred_one_by_one(device, monkeypatch):
    """The device needs memory for a single realization only."""
    request = []

    def made(engine, geometry, grid, lanes, threads):
        request.append((engine, lanes))
        cpu = engine == "cpu"
        return CpuProjector(geometry, grid, lanes) if cpu else AstraCudaProjector(geometry, grid, lanes, device)

    monkeypatch.setattr(images, "projector", made)
    scan = np.random.default_rng(5).random((3, GEOMETRY.views, GEOMETRY.rows, GEOMETRY.columns), np.float32)
    settings = SirtSettings(**SIRT | {"iterations": 4, "backprojector": "voxel"})
    actual, theirs = (
        images.reconstruct_hu(scan, GEOMETRY, GRID, "sirt", settings, engine, 0.02) for engine in ("cpu", "astra_cuda")
    )
    assert request == [("cpu", 3), ("astra_cuda", 1)]
    assert np.sqrt(np.mean((actual - theirs) ** 2)) < 1e-3 * actual.std()


@needs_cuda
@pytest.mark.gpu
def test_gpu_and_cpu_projections_agree():
    cpu = CpuProjector(GEOMETRY, GRID)
    gpu = projectors.projector("astra_cuda", GEOMETRY, GRID)
    ball = _ball()
    actual = cpu.unpack_projections(cpu.forward(cpu.pack_volume(ball[None])))
    theirs = gpu.unpack_projections(gpu.forward(gpu.pack_volume(ball[None])))
    assert np.sqrt(np.mean((actual - theirs) ** 2)) < 1e-4 * actual.max()


@needs_cuda
@pytest.mark.gpu
def test_gpu_and_cpu_back_projections_agree():
    """Up to ASTRA's scale.

    Its textures interpolate between pixels with weights of 8 bits (CUDA C++ Programming Guide, Texture Fetching), an
    error of up to 1/512 of their difference.
    """
    cpu = CpuProjector(GEOMETRY, GRID)
    gpu = projectors.projector("astra_cuda", GEOMETRY, GRID)
    scan = np.random.default_rng(3).random((1, GEOMETRY.views, GEOMETRY.rows, GEOMETRY.columns), np.float32)
    actual = cpu.unpack_volume(cpu.back(cpu.pack_projections(scan)))
    theirs = gpu.unpack_volume(gpu.back(gpu.pack_projections(scan)))
    theirs = theirs * (np.vdot(actual, theirs) / np.vdot(theirs, theirs))
    assert np.sqrt(np.mean((actual - theirs) ** 2)) < 0.004 * actual.std()


@needs_cuda
@pytest.mark.gpu
def test_gpu_and_cpu_reconstructions_agree():
    """Images differ by at most 3 % of the noise SD (rms), from weights of 8 bits over 500 iterations."""
    cpu = CpuProjector(GEOMETRY, GRID)
    lines = cpu.unpack_projections(cpu.forward(cpu.pack_volume(0.02 * _ball()[None])))
    noise = np.random.default_rng(7).normal(0, 0.02, lines.shape).astype(np.float32)
    settings = SirtSettings(**SIRT | {"iterations": 500, "terms": 60, "backprojector": "voxel"})
    quiet, actual, theirs = (
        images.reconstruct_hu(data, GEOMETRY, GRID, "sirt", settings, engine, 0.02)[0]
        for data, engine in ((lines, "cpu"), (lines + noise, "cpu"), (lines + noise, "astra_cuda"))
    )
    assert np.sqrt(np.mean((actual - theirs) ** 2)) < 0.03 * (actual - quiet).std()


def _ball():
    z, y, x = GRID.axes_mm()
    return np.exp(-(x**2 + y[:, None] ** 2 + (2 * z[:, None, None]) ** 2) / 2000).astype(np.float32)
