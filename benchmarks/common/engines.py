"""Projectors of Virtual Phantom, RTK (CPU), ASTRA (2D fan beam) and XCIST, with one thread each.

An engine has functions that project or back-project the whole scan once, and the numbers of rays and of voxels times
views, by which the times are divided.
"""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from benchmarks.common import child_seconds
from virtual_phantom.base.geometry import Grid, ScanGeometry, circular, helical
from virtual_phantom.projectors.cpu import CpuProjector

# Grid and detector of the paper's groups (config/paper_groups.yaml), on a circle.
GRID = Grid((48, 128, 128), (2.0, 2.35, 2.35))
SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0)
DETECTOR = dict(columns=160, rows=48, column_pitch_mm=4.0, row_pitch_mm=4.0)
VIEWS = 16


@dataclass(frozen=True)
class Engine:
    """A projector; missing functions are None. `projected`, [view, row, column], is None if the rays are others."""

    name: str
    forward: Callable[[], object] | None
    back: Callable[[], object] | None
    rays: float
    voxels_by_views: float
    projected: np.ndarray | None = None


def geometry(views: int = VIEWS) -> ScanGeometry:
    return circular(views=views, **DETECTOR, **SCANNER)


def helix() -> ScanGeometry:
    """Helix with the rotations of the paper's groups; rays leave the ends of the grid."""
    return helical(views=3 * VIEWS, volume_height_mm=GRID.extent_mm[0], **DETECTOR, **SCANNER)


def phantom(grid: Grid = GRID) -> np.ndarray:
    """An ellipsoid with a ball beside its middle, 1/mm, [z, y, x]."""
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    body = (x / 120) ** 2 + (y / 90) ** 2 + (z / 42) ** 2 < 1
    ball = (x - 40) ** 2 + (y - 20) ** 2 + z**2 < 25**2
    return (0.02 * body + 0.01 * ball).astype(np.float32)


def virtual_phantom(lanes: int, scan: ScanGeometry, grid: Grid = GRID, transpose: bool = False) -> Engine:
    """Virtual Phantom's projector with a batch of `lanes`; transpose: the exact adjoint, not the voxel-driven one."""
    projector = CpuProjector(scan, grid, lanes)
    volume = projector.pack_volume(np.repeat(phantom(grid)[None], lanes, 0))
    projections, out = projector.forward(volume), projector.empty_volume()
    back = projector.adjoint if transpose else projector.back
    circle = scan.feed_per_rotation_mm == 0
    return Engine(
        f"Virtual Phantom, {lanes} at once" + (", adjoint" if transpose else "") + ("" if circle else ", helix"),
        lambda: projector.forward(volume),
        lambda: back(projections, out=out),
        lanes * projections[:, 1:-1, 1:-1, 0].size,
        lanes * volume[1:-1, 1:-1, 1:-1, 0].size * scan.views,
        projector.unpack_projections(projections)[0] if circle else None,
    )


def rtk_image(array: np.ndarray, spacing, origin):
    """An ITK image of an array whose axes ITK counts backwards."""
    import itk

    image = itk.image_from_array(np.ascontiguousarray(array, np.float32))
    image.SetSpacing([float(one) for one in spacing])
    image.SetOrigin([float(one) for one in origin])
    return image


def rtk_parts(scan: ScanGeometry, grid: Grid):
    """RTK's geometry, and a volume and projections in its axes: y is the axis of rotation, and angles run backwards."""
    import itk
    from itk import RTK

    itk.MultiThreaderBase.SetGlobalMaximumNumberOfThreads(1)
    itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(1)
    there = RTK.ThreeDCircularProjectionGeometry.New()
    for angle in np.rad2deg(scan.angles_rad):
        there.AddProjection(scan.source_to_isocentre_mm, scan.source_to_detector_mm, float(-angle))
    z, y, x = grid.axes_mm()
    dz, dy, dx = grid.spacing
    volume = rtk_image(phantom(grid).transpose(1, 0, 2), (dx, dz, dy), (x[0], z[0], y[0]))
    empty = rtk_projections(np.zeros((scan.views, scan.rows, scan.columns)), scan)
    return there, volume, empty


def rtk_projections(array: np.ndarray, scan: ScanGeometry):
    """An ITK image of [view, row, column]."""
    origin = (scan.column_positions_mm()[0], scan.row_positions_mm()[0], 0.0)
    return rtk_image(array, (scan.column_pitch_mm, scan.row_pitch_mm, 1.0), origin)


def rtk(scan: ScanGeometry, grid: Grid = GRID, transpose: bool = False) -> Engine:
    """RTK's Joseph forward projection, and its voxel-based back-projection or the transpose of Joseph's."""
    import itk
    from itk import RTK

    kind = itk.Image[itk.F, 3]
    there, volume, _ = rtk_parts(scan, grid)
    z, y, x = grid.axes_mm()
    dz, dy, dx = grid.spacing
    filters = RTK.JosephBackProjectionImageFilter if transpose else RTK.BackProjectionImageFilter

    # Filters reuse the memory of their first input, so each run needs a new one.
    def forward():
        ahead = RTK.JosephForwardProjectionImageFilter[kind, kind].New()
        ahead.SetInput(0, rtk_projections(np.zeros((scan.views, scan.rows, scan.columns)), scan))
        ahead.SetInput(1, volume)
        ahead.SetGeometry(there)
        ahead.Update()
        return itk.array_from_image(ahead.GetOutput())

    projected = forward()
    projections = rtk_projections(projected, scan)

    def back():
        behind = filters[kind, kind].New()
        behind.SetInput(0, rtk_image(np.zeros((y.size, z.size, x.size)), (dx, dz, dy), (x[0], z[0], y[0])))
        behind.SetInput(1, projections)
        behind.SetGeometry(there)
        behind.Update()

    return Engine(
        "RTK, Joseph" + (", its transpose" if transpose else ", voxel-based back"),
        forward,
        back,
        projected.size,
        phantom(grid).size * scan.views,
        projected,
    )


def fan_projector(scan, angles: np.ndarray, shape: tuple[int, int], spacing: tuple[float, float], rays: int = 1):
    """ASTRA's fan-beam projector of a slice [y, x], with `rays` per column of a scan; its rows run downwards."""
    import astra

    (ny, nx), (dy, dx) = shape, spacing
    volume = astra.create_vol_geom(ny, nx, -nx * dx / 2, nx * dx / 2, -ny * dy / 2, ny * dy / 2)
    along, across = np.stack([-np.sin(angles), np.cos(angles)], 1), np.stack([np.cos(angles), np.sin(angles)], 1)
    source, beyond = scan.source_to_isocentre_mm, scan.source_to_detector_mm - scan.source_to_isocentre_mm
    vectors = np.concatenate([source * along, -beyond * along, scan.column_pitch_mm / rays * across], 1)
    detector = astra.create_proj_geom("fanflat_vec", scan.columns * rays, vectors)
    return astra.create_projector("line_fanflat", detector, volume)


def astra_parts(scan: ScanGeometry, grid: Grid):
    """ASTRA's fan-beam projector of the middle slice, and the slice."""
    image = phantom(grid)[grid.shape[0] // 2, ::-1].copy()
    return fan_projector(scan, scan.angles_rad, image.shape, grid.spacing[1:]), image


def astra_fan(scan: ScanGeometry, grid: Grid = GRID) -> Engine:
    """ASTRA's 2D fan beam on the CPU ('line_fanflat'), one slice: its transpose is its back-projection."""
    import astra

    projector, image = astra_parts(scan, grid)
    made, sinogram = astra.create_sino(image, projector)
    astra.data2d.delete(made)

    def forward():
        made, _ = astra.create_sino(image, projector)
        astra.data2d.delete(made)

    def back():
        made, _ = astra.create_backprojection(sinogram, projector)
        astra.data2d.delete(made)

    return Engine("ASTRA, 2D fan beam", forward, back, sinogram.size, image.size * scan.views)


def xcist_ns_per_ray(scan: ScanGeometry, grid: Grid, few: int = 4, many: int = 16) -> float:
    """Time per ray of XCIST's distance-driven projector, from the additional time of more views."""
    from virtual_phantom.proof.hiding.xcist import Materials, Scan, simulate

    def seconds(views):
        order = Scan(views=views, kev=70.0, photons=1e5, **DETECTOR, **SCANNER)
        water = Materials({"water": phantom(grid) * 50}, (grid.spacing[2], grid.spacing[0]))
        before = child_seconds()[0]
        simulate(order, water, 1, np.random.SeedSequence(1))
        return child_seconds()[0] - before

    rays = scan.rows * scan.columns * math.prod(Materials.cells_divided)
    return (seconds(many) - seconds(few)) / (many - few) / rays * 1e9


@njit(fastmath=True)
def _add(total, more, times):
    for _ in range(times):
        for i in range(total.size):
            total[i] += more[i]


def cache_bytes_per_ns(kib: int, times: int = 400) -> float:
    """Bandwidth of one core for the sum of two arrays of `kib` in total."""
    one, other = np.ones((2, kib * 1024 // 8), np.float32)
    _add(one, other, 1)
    began = time.process_time()
    _add(one, other, times)
    return 3 * one.nbytes * times / (time.process_time() - began) / 1e9


def machine() -> str:
    """Processor, cores and memory."""
    with open("/proc/cpuinfo") as file:
        name = next(line.split(":")[1].strip() for line in file if line.startswith("model name"))
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return f"{name}, {os.cpu_count()} cores, {memory:.0f} GiB"


def ns_of_a_view(row):
    """Time of forward and back-projection of one view, ns."""
    rays, voxels = DETECTOR["columns"] * DETECTOR["rows"], np.prod(GRID.shape)
    return float(rays * row["forward_ns_per_ray"] + voxels * row["back_ns_per_voxel_and_view"])
