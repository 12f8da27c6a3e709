"""Filtered back-projection of the default study on the GPU and the CPU engine, beside ASTRA's and RTK's own FDK."""

import math
import os
import time
from collections import Counter
from types import SimpleNamespace

import astra
import numpy as np

from benchmarks import common
from benchmarks.common.engines import rtk_image, rtk_parts, rtk_projections
from virtual_phantom.base.geometry import Grid, circular, grid_of, scan_geometry
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.projectors import parallel_cuda
from virtual_phantom.projectors.astra_cuda import AstraCudaProjector, volume_geometry
from virtual_phantom.reconstruction.boxes import back_in_boxes, boxes_around, voxels_over
from virtual_phantom.reconstruction.fbp import Filter, ParallelProjections
from virtual_phantom.reconstruction.images import kernel_of

PROTOCOLS = ("group_2", "group_8", "whole_fbp")
CUBE_MM = 0.5  # all voxels of the whole image are then in the beam of a circular scan
NOISE = 0.02  # standard deviation of a line integral
REPEATS = 3


class TimedDevice:
    """CuPy as parallel_cuda uses it, with the wall time of each stage; calls wait for the device."""

    def __init__(self, cupy):
        self._cupy, self.zeros, self.seconds = cupy, cupy.zeros, Counter()
        self._stage, self._began = "other work", time.perf_counter()
        self.asarray = self._timed("transfer to the device", cupy.asarray)
        self.asnumpy = self._timed("copy back", cupy.asnumpy)
        # The product with the ramp, and the copy of the filtered rows, belong to the filter.
        transforms = (self._timed("filter", function, "filter") for function in (cupy.fft.rfft, cupy.fft.irfft))
        self.fft = SimpleNamespace(**dict(zip(("rfft", "irfft"), transforms, strict=True)))

    def RawModule(self, code):
        module = self._cupy.RawModule(code=code)
        names = {"rebin": "rebinning", "back_project": "back-projection"}
        return SimpleNamespace(get_function=lambda name: self._timed(names[name], module.get_function(name)))

    def start(self, stage="other work"):
        """End the current stage, and start another one."""
        self._cupy.cuda.get_current_stream().synchronize()
        now = time.perf_counter()
        self.seconds[self._stage] += now - self._began
        self._stage, self._began = stage, now

    def _timed(self, stage, function, afterwards="other work"):
        def run(*arguments, **settings):
            self.start(stage)
            result = function(*arguments, **settings)
            self.start(afterwards)
            return result

        return run


def seconds_of(function, repeats):
    """Median of the wall times of some calls, and the last result."""
    took = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = function()
        took.append(time.perf_counter() - began)
    return float(np.median(took)), result


def stages_on_device(reconstruct):
    """{stage: seconds} of one image, in which the host waits for the device after each stage."""
    usual = parallel_cuda.device_arrays
    device = TimedDevice(usual())
    parallel_cuda.device_arrays = lambda: device
    try:
        reconstruct()  # compiles
        device.start()
        device.seconds.clear()
        reconstruct()
        device.start()
    finally:
        parallel_cuda.device_arrays = usual
    return device.seconds


def noisy_scan(geometry, grid, object_):
    """Line integrals of an object with noise, [1, view, row, column], projected by ASTRA."""
    gpu = AstraCudaProjector(geometry, grid)
    lines = gpu.unpack_projections(gpu.forward(gpu.pack_volume(object_[None])))
    random = np.random.default_rng(np.random.SeedSequence(7))
    return lines + np.float32(NOISE) * random.standard_normal(lines.shape, np.float32)


def parts_of(config, name, grid):
    """Voxels and boxes of a protocol's images, and the slice thickness."""
    voxels = config.protocols[name].voxels
    if voxels is None:
        return grid, [tuple(slice(0, count) for count in grid.shape)], None
    fine = voxels_over(grid, voxels.spacing_mm)
    seed = branch(config.seed, Branch.PHANTOM)
    rois = synthetic.rois(layout.read_layout(config.phantom.layout), fine, seed)
    return fine, boxes_around([roi.mask for roi in rois], fine), voxels.thickness_mm


def projected(lines, geometry, kernel, engine="cpu"):
    return ParallelProjections.of(lines, geometry, [Filter(kernel)], engine=engine)


def print_protocol(config, name, lines, geometry, grid):
    fine, boxes, thickness_mm = parts_of(config, name, grid)
    kernel = kernel_of(config.protocols[name])
    settings = dict(mu_water_per_mm=config.mu_water_per_mm, thickness_mm=thickness_mm)

    def on_gpu():
        return back_in_boxes(projected(lines, geometry, kernel, "astra_cuda"), fine, boxes, **settings)[0]

    on_gpu()  # CuPy compiles
    seconds, image = seconds_of(on_gpu, REPEATS)
    voxels = sum(np.prod([part.stop - part.start for part in box]) for box in boxes)
    print(f"{name}: {len(boxes)} boxes with {voxels:,} voxels, {geometry.views} views")
    print(f"  GPU {seconds:.3f} s per image; stages, one after the other:", flush=True)
    for stage, took in stages_on_device(on_gpu).items():
        print(f"    {stage:24}{took:.3f} s")
    rays = None
    for threads in (os.cpu_count(), 1):
        if rays is None:
            filtering, rays = seconds_of(lambda: projected(lines, geometry, kernel), 1)
            back_in_boxes(rays, fine, boxes[:1], **settings)  # Numba compiles
        took, theirs = seconds_of(lambda: back_in_boxes(rays, fine, boxes, threads=threads, **settings)[0], 1)  # noqa: B023
        print(
            f"  CPU, {threads} threads: {filtering + took:.2f} s, of which rebinning and filter {filtering:.2f} s (one "
            f"thread) and back-projection {took:.2f} s",
            flush=True,
        )
    difference = image - theirs
    incomplete = int(((image == HU_AIR) != (theirs == HU_AIR)).sum())
    inside = theirs != HU_AIR
    rms = np.sqrt(np.mean(difference[inside] ** 2, dtype=np.float64))
    print(f"  difference in HU: rms {rms:.1e}, max {np.abs(difference).max():.1e};")
    print(f"  {incomplete} voxels are air in one image only; rounded to whole HU, ", end="")
    print(f"{int((np.rint(image) != np.rint(theirs)).sum())} of {int(inside.sum()):,} voxels differ", flush=True)


def astra_fdk(lines, geometry, grid):
    """ASTRA's FDK_CUDA on a circular scan, with its transfers: seconds per image."""
    angles = geometry.angles_rad
    distances = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm - geometry.source_to_isocentre_mm
    pitches = geometry.column_pitch_mm, geometry.row_pitch_mm
    cone = astra.create_proj_geom("cone", *pitches, geometry.rows, geometry.columns, angles, *distances)
    image = astra.data3d.create("-vol", volume_geometry(grid), 0)
    data = astra.data3d.create("-sino", cone, np.ascontiguousarray(np.swapaxes(lines[0], 0, 1)))
    chosen = astra.astra_dict("FDK_CUDA") | {"ReconstructionDataId": image, "ProjectionDataId": data}
    solver = astra.algorithm.create(chosen)
    astra.algorithm.run(solver)
    seconds, _ = seconds_of(lambda: astra.algorithm.run(solver), REPEATS)
    found = astra.data3d.get(image)
    astra.algorithm.delete(solver)
    astra.data3d.delete([image, data])
    return seconds, found


def rtk_fdk(lines, geometry, grid):
    """RTK's FDK on all cores: seconds per image, and the image."""
    import itk
    from itk import RTK

    there, _, _ = rtk_parts(geometry, grid)  # limits ITK to one thread
    itk.MultiThreaderBase.SetGlobalMaximumNumberOfThreads(os.cpu_count())
    itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(os.cpu_count())
    z, y, x = grid.axes_mm()
    dz, dy, dx = grid.spacing

    def reconstruct():
        fdk = RTK.FDKConeBeamReconstructionFilter[itk.Image[itk.F, 3]].New()
        fdk.SetInput(0, rtk_image(np.zeros((y.size, z.size, x.size)), (dx, dz, dy), (x[0], z[0], y[0])))
        fdk.SetInput(1, rtk_projections(lines[0], geometry))
        fdk.SetGeometry(there)
        fdk.Update()
        return itk.array_from_image(fdk.GetOutput()).transpose(1, 0, 2)

    reconstruct()  # ITK loads its modules
    return seconds_of(reconstruct, 1)


def print_rivals(geometry, grid, object_, kernel):
    """Print times of FDK programs on a circular scan with the same numbers of views, pixels and voxels."""
    scan = circular(
        views=geometry.views,
        source_to_isocentre_mm=geometry.source_to_isocentre_mm,
        source_to_detector_mm=geometry.source_to_detector_mm,
        columns=geometry.columns,
        rows=geometry.rows,
        column_pitch_mm=geometry.column_pitch_mm,
        row_pitch_mm=geometry.row_pitch_mm,
    )
    lines = noisy_scan(scan, grid, object_)
    cubes = Grid(grid.shape, (CUBE_MM,) * 3)
    middle = tuple(slice(count // 2 - 1, count // 2 + 1) for count in grid.shape)
    print(f"circular scan of {scan.views} views, {math.prod(grid.shape):,} voxels (ASTRA and RTK have no helical FBP):")
    box = [tuple(slice(0, count) for count in grid.shape)]

    def ours():
        projections = projected(lines, scan, kernel, "astra_cuda")
        return back_in_boxes(projections, cubes, box, mu_water_per_mm=0.02)[0]

    ours()
    seconds, image = seconds_of(ours, REPEATS)
    print(f"  Virtual Phantom, GPU: {seconds:.3f} s; center {0.02 * (1 + image[0][middle].mean() / 1000):.5f} / mm")
    seconds, image = astra_fdk(lines, scan, cubes)
    print(f"  ASTRA FDK_CUDA: {seconds:.3f} s; center {image[middle].mean():.5f} / mm", flush=True)
    try:
        from itk import RTK  # noqa: F401
    except ImportError:
        print("  RTK: itk-rtk is not installed here")
        return
    seconds, image = rtk_fdk(lines, scan, cubes)
    print(f"  RTK, CPU, {os.cpu_count()} threads: {seconds:.3f} s; center {image[middle].mean():.5f} / mm", flush=True)


def run(phantom):
    """Print all comparisons. `phantom` makes an object on a grid, 1/mm."""
    config = common.configuration("config/config.yaml")
    grid = grid_of(config.grid)
    object_ = phantom(grid)
    protocol = config.protocols[PROTOCOLS[0]]
    geometry = scan_geometry(config.scan, protocol.projections, grid)
    lines = noisy_scan(geometry, grid, object_)
    for name in PROTOCOLS:
        print_protocol(config, name, lines, geometry, grid)
    print_rivals(geometry, grid, object_, kernel_of(protocol))
