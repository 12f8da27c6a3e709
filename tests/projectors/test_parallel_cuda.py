"""Filtered back-projection on the GPU: the kernels compiled as C and run on the CPU, and on a device."""

import astra
import numpy as np
import pytest
from on_device import Device
from scanner import SCANNER

from virtual_phantom import projectors
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical, parallel_beam
from virtual_phantom.base.settings import FbpSettings, from_mapping
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.projectors import parallel_cuda
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction import boxes, images

needs_cuda = pytest.mark.skipif(
    not (astra.use_cuda() and projectors.cupy_installed()), reason="ASTRA finds no CUDA device here, or no CuPy"
)
MU = 0.02
GRID = Grid((11, 40, 44), (1.6, 2.0, 1.8))
DETECTOR = dict(SCANNER, columns=60, rows=10, column_pitch_mm=3.0, row_pitch_mm=4.0)
OFFSET = DETECTOR | dict(column_offset_px=0.25, row_offset_px=-0.4)
ALONG_Z = ((0.0, 3.0, -0.6), (0.0, -3.0, 0.6))
BOTH = ((-0.4, 3.0, -0.6), (0.4, 3.0, -0.6), (-0.4, -3.0, 0.6), (0.4, -3.0, 0.6))
HELIX = helical(views=170, volume_height_mm=20, **DETECTOR)
SCANS = {
    "helix": HELIX,
    "helix, backwards": helical(views=170, volume_height_mm=20, direction=-1, start_angle_rad=1.1, **OFFSET),
    "circle": circular(views=100, **OFFSET),
    "two circles": circular(views=200, turns=2, start_angle_rad=5.0, **DETECTOR),
    "short scan": circular(views=90, turns=0.7, direction=-1, **DETECTOR),
    "one row": circular(views=90, **DETECTOR | dict(rows=1, column_offset_px=0.25)),
    "arc": helical(views=170, volume_height_mm=20, surface="cylindrical", **OFFSET),
    "spots along z": helical(views=170, volume_height_mm=20, spots_mm=ALONG_Z, **DETECTOR | {"surface": "cylindrical"}),
    "four spots": circular(views=200, spots_mm=BOTH, **OFFSET | {"surface": "cylindrical"}),
    "parallel": circular(views=90, turns=0.5, **DETECTOR | {"column_pitch_mm": 1.5} | parallel_beam()),
}
SMOOTH = {"mtf50_per_cm": 2.5, "mtf10_per_cm": 4.2}
SOFTER = {"mtf50_per_cm": 1.75, "mtf10_per_cm": 2.94, "variance": 0.5}


@pytest.fixture
def device(monkeypatch):
    arrays = Device()
    monkeypatch.setattr(parallel_cuda, "device_arrays", lambda: arrays)
    monkeypatch.setattr(parallel_cuda, "ROWS_AT_ONCE", 640)  # several blocks of images, the last one smaller
    yield arrays
    arrays.check()


def lines_of(geometry, lanes=1):
    """Line integrals of a ball, with noise."""
    cpu = CpuProjector(geometry, GRID)
    z, y, x = GRID.axes_mm()
    ball = np.exp(-((x - 9) ** 2 + (y[:, None] + 5) ** 2 + (2 * z[:, None, None]) ** 2) / 500).astype(np.float32)
    clean = cpu.unpack_projections(cpu.forward(cpu.pack_volume(MU * ball[None])))[0]
    noise = np.random.default_rng(4).normal(0, 0.02, (lanes, *clean.shape)).astype(np.float32)
    return clean + noise, clean


def assert_same(gpu, cpu):
    """Images differ by rounding in single precision, by less than 1e-6 (rms) of the contrast.

    Sums and transforms have another order, and the CPU rounds the height of the lowest voxel on the detector to 1e-5
    rows.
    """
    assert (cpu == HU_AIR).mean() < 0.93
    assert np.sqrt(np.mean((gpu - cpu) ** 2)) < 2e-6 * cpu.std()
    assert np.abs(gpu - cpu).max() < 2e-5 * cpu.std()


def on_both(geometry, lines, clean=None, **kernels):
    settings = from_mapping(FbpSettings, {"normalise": "coverage", **kernels})
    return [
        images.reconstruct_hu(lines, geometry, GRID, "fbp", settings, engine, MU, clean=clean)
        for engine in ("astra_cuda", "cpu")
    ]


@pytest.mark.parametrize("name", SCANS)
def test_kernels_give_the_images_of_the_cpu_engine(name, device):
    assert_same(*on_both(SCANS[name], lines_of(SCANS[name])[0]))


def test_realizations_and_kernels_of_object_and_noise(device):
    lines, clean = lines_of(HELIX, lanes=3)
    assert_same(*on_both(HELIX, lines, kernel=SMOOTH))
    assert_same(*on_both(HELIX, lines, clean, kernel=SMOOTH, noise_kernel=SOFTER))


def thick_slices(engine, lines, clean):
    made = [(slice(2, 9), slice(8, 22), slice(6, 17)), (slice(0, 5), slice(28, 40), slice(18, 24))]
    settings = from_mapping(FbpSettings, {"normalise": "coverage", "kernel": SMOOTH, "noise_kernel": SOFTER})
    projections = images.filtered(lines, HELIX, [settings], clean, engine)
    return boxes.back_in_boxes(projections, GRID, made, mu_water_per_mm=MU, thickness_mm=2.4)[0]


def test_boxes_of_thick_slices(device):
    lines, clean = lines_of(HELIX, lanes=2)
    assert_same(thick_slices("astra_cuda", lines, clean), thick_slices("cpu", lines, clean))


def test_values_beyond_an_array_are_noticed():
    """A test of the tests."""
    code = "KERNEL read(float *a, int n)\n{\n    a[threadIdx.x] = a[threadIdx.x + n];\n}\n"
    code += "KERNEL write(float *a, int n)\n{\n    a[threadIdx.x + n] = 0.0f;\n}\n"
    device = Device()
    array, get = device.zeros((4,), np.float32), device.RawModule(code).get_function
    get("read")((1, 1, 1), (4, 1, 1), (array, np.int32(1)))
    assert np.isnan(device.asnumpy(array)).tolist() == [False, False, False, True]
    get("write")((1, 1, 1), (4, 1, 1), (array, np.int32(0)))
    device.check()
    get("write")((1, 1, 1), (4, 1, 1), (array, np.int32(1)))
    with pytest.raises(AssertionError, match="written beyond an array"):
        device.check()


def test_full_memory_is_reported(device, monkeypatch):
    def full(*_, **__):
        raise MemoryError("Out of memory allocating 512 bytes")

    monkeypatch.setattr(device, "zeros", full)
    with pytest.raises(InputError, match="astra_cuda: Out of memory allocating 512 bytes; free the device's memory"):
        on_both(HELIX, lines_of(HELIX)[0])


def test_fdk_needs_the_cpu_engine(device):
    settings = from_mapping(FbpSettings, {"normalise": "none"})
    with pytest.raises(InputError, match="no FDK; set engine: cpu or reconstruction.fbp.normalise: coverage"):
        images.reconstruct_hu(lines_of(HELIX)[0], HELIX, GRID, "fbp", settings, "astra_cuda", MU)


def test_grid_must_be_inside_the_orbit(device):
    with pytest.raises(InputError, match="outside the source's orbit"):
        projectors.parallel_projector("astra_cuda", HELIX, Grid((1, 500, 500), (1.0, 2.0, 2.0)))


@needs_cuda
@pytest.mark.gpu
@pytest.mark.parametrize("name", SCANS)
def test_gpu_and_cpu_images_agree(name):
    assert_same(*on_both(SCANS[name], lines_of(SCANS[name])[0]))


@needs_cuda
@pytest.mark.gpu
def test_gpu_and_cpu_boxes_agree():
    lines, clean = lines_of(HELIX, lanes=2)
    assert_same(*on_both(HELIX, lines, clean, kernel=SMOOTH, noise_kernel=SOFTER))
    assert_same(thick_slices("astra_cuda", lines, clean), thick_slices("cpu", lines, clean))
