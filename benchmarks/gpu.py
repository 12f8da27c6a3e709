"""Compare the GPU engine with the CPU engine and with ASTRA's SIRT3D_CUDA at the paper's scale (minutes; needs CUDA).

First run `pip install -r environment-gpu.txt`. Runs the GPU tests and prints, for each number of projections of
config/paper.yaml, the difference of the forward projections and the times of Chebyshev SIRT and of its projections. For
plain SIRT iterations of ASTRA, it prints the time, the image difference relative to noise, and memory.

With --fbp, it compares filtered back-projection in the default study instead (3 minutes). It prints seconds per image
by stage, the differences from the CPU engine in HU, and the times of ASTRA's FDK_CUDA and RTK's FDK.
"""

import resource
import subprocess
import sys
import time

import astra
import numpy as np

from benchmarks import common
from benchmarks.common import gpu_fbp
from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.projectors import cupy_installed
from virtual_phantom.projectors.astra_cuda import AstraCudaProjector, projection_geometry, volume_geometry
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction.sirt import sirt

NOISE = 0.02  # standard deviation of a line integral
VIEWS_SHARE = 8  # every eighth view is projected on the CPU


def phantom(grid):
    """An ellipsoid with a ball in it, 1/mm, [z, y, x]."""
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij", sparse=True)
    body = (x / 140) ** 2 + (y / 100) ** 2 + (z / 200) ** 2 < 1
    return (0.02 * body + 0.01 * ((x - 40) ** 2 + (y - 20) ** 2 + z**2 < 25**2)).astype(np.float32)


def plain_on_device(projector, lines, iterations):
    """Seconds and image of ASTRA's own SIRT, which keeps its data on the device."""
    image = astra.data3d.create("-vol", volume_geometry(projector.grid), 0)
    taken = np.ascontiguousarray(np.swapaxes(lines[0], 0, 1))
    data = astra.data3d.create("-sino", projection_geometry(projector.geometry), taken)
    began = time.perf_counter()
    chosen = astra.astra_dict("SIRT3D_CUDA") | {"ReconstructionDataId": image, "ProjectionDataId": data}
    solver = astra.algorithm.create(chosen)
    astra.algorithm.run(solver, iterations)
    seconds = time.perf_counter() - began
    found = astra.data3d.get(image)
    astra.algorithm.delete(solver)
    astra.data3d.delete([image, data])
    return seconds, found


def compare(config, projections, threads):
    import cupy

    grid = grid_of(config.grid)
    geometry = scan_geometry(config.scan, projections, grid)
    object_ = phantom(grid)
    gpu = AstraCudaProjector(geometry, grid)
    lines = gpu.unpack_projections(gpu.forward(gpu.pack_volume(object_[None])))
    some = slice(0, projections, VIEWS_SHARE)
    fewer = geometry.every(VIEWS_SHARE)
    cpu = CpuProjector(fewer, grid, threads=2)
    theirs = cpu.unpack_projections(cpu.forward(cpu.pack_volume(object_[None])))
    off = np.sqrt(np.mean((lines[:, some] - theirs) ** 2)) / theirs.max()
    print(f"{projections} projections: rms difference of projections {off:.3%} of the largest", flush=True)

    random = np.random.default_rng(np.random.SeedSequence(7))
    noise = random.normal(0, NOISE, lines.shape).astype(np.float32)
    sirt_settings = vars(config.reconstruction.sirt) | {"backprojector": "voxel", "solver": "chebyshev"}
    sirt_settings |= {"terms": 60, "tolerance_hu": 0}
    sirt(gpu, lines, **(sirt_settings | {"iterations": 2, "terms": 2}))  # CuPy compiles
    began = time.perf_counter()
    image = sirt(gpu, lines + noise, **sirt_settings)[0]
    chebyshev = time.perf_counter() - began
    allocated = cupy.get_default_memory_pool().total_bytes()
    began = time.perf_counter()
    volume = gpu.pack_volume(object_[None])
    for _ in range(sirt_settings["terms"] + 1):
        gpu.back(gpu.forward(volume))
    cupy.cuda.get_current_stream().synchronize()
    projecting = time.perf_counter() - began
    quiet = sirt(gpu, lines, **sirt_settings)[0]
    plain, reference = plain_on_device(gpu, lines + noise, sirt_settings["iterations"])
    inside = object_ > 0
    spread = (image - quiet)[inside].std()
    difference = np.sqrt(np.mean((image - reference)[inside] ** 2)) / spread
    print(f"  Chebyshev SIRT {chebyshev:.1f} s, its projections alone {projecting:.1f} s")
    print(f"  {sirt_settings['iterations']} plain iterations of ASTRA {plain:.1f} s: {plain / chebyshev:.1f} times")
    print(f"  images differ by {difference:.2%} of the noise's standard deviation")
    if threads:
        cpu = CpuProjector(geometry, grid, threads=threads)
        began = time.perf_counter()
        theirs = sirt(cpu, lines + noise, **sirt_settings)[0]
        seconds = time.perf_counter() - began
        difference = np.sqrt(np.mean((image - theirs)[inside] ** 2)) / spread
        print(f"  the CPU engine's image, {threads} threads, {seconds:.1f} s, differs by {difference:.2%} of it")
    print(f"  memory of this process so far {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB,")
    print(f"  of the device, without ASTRA's own copies, {allocated / 2**30:.1f} GiB", flush=True)


def add_arguments(parser):
    parser.add_argument("--projections", type=int, nargs="+", default=[150, 450])
    parser.add_argument(
        "--cpu-threads", type=int, default=0, help="also reconstruct on the CPU with this number of threads"
    )
    parser.add_argument("--fbp", action="store_true", help="compare filtered back-projection of the default study only")


def run(options):
    if not astra.use_cuda():
        sys.exit("ASTRA finds no CUDA device here; run this where there is one")
    if not cupy_installed():
        sys.exit("CuPy is not installed here: pip install -r environment-gpu.txt")
    if options.fbp:
        print(astra.get_gpu_info())
        gpu_fbp.run(phantom)
        return
    tests = subprocess.run([sys.executable, "-m", "pytest", "-q", "-m", "gpu", "tests/projectors"], cwd=common.ROOT)
    print(astra.get_gpu_info())
    config = common.configuration("config/paper.yaml")
    for projections in options.projections:
        compare(config, projections, options.cpu_threads)
    sys.exit(tests.returncode)
