"""CUDA kernels of weighted filtered back-projection: rebinning to parallel rays, and their back-projection.

They compute what ParallelRays and parallel.py compute: positions in double precision, interpolation in single
precision. Sums have another order, so results differ by rounding only. Arrays on the device are float32::

    projections  [view, row, column]
    images       [level and angle, row, t], the rebinned projections
    volume       [z, y, x]
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from ..base.parallel_rays import ParallelRays
from . import check_device
from .cpu import check_in_orbit

SLICES = 8  # voxels of one thread, along z: they share the in-plane geometry
# C, and not C++, so that the tests can compile it for any processor. There, KERNEL is a plain function.
SOURCE = (
    rf"#define SLICES {SLICES}"
    + r"""
#ifndef KERNEL
#define KERNEL extern "C" __global__ void
#endif
/* See ParallelRays and parallel.ParallelScan. */
typedef struct {
    int views, rows, columns, spots, periodic;
    int width; /* number of distances t */
    int angles, levels, half_turn;
    double first_t, t_pitch, first_row, row_pitch;
    double rise; /* of the source per radian of rotation */
    double full; /* central fraction of the rows with full weight */
} Scan;

/* The two samples from which the ray at a distance t is interpolated. */
typedef struct {
    double views_earlier[2]; /* than the central ray of the same direction */
    float weight[2];
    int spot[2], column[2];
} Samples;

/* Parallel rays of one level and angle. */
typedef struct {
    double sine, cosine;
    double radius, up; /* of the level: distance from the axis, and height above the focal center */
    double source_z;   /* height of the source of the central ray */
} Direction;

/* Interpolate projections to parallel rays. One thread per t, row and angle, from angle number `first` on. `samples`
   are for one level. Rows of `images` have a length of `padded`. */
KERNEL rebin(float *images, const float *projections, const float *cone_cosine, const double *view_of_angle,
             const Samples *samples, const Scan *scan, int first, int padded)
{
    const int t = blockIdx.x * blockDim.x + threadIdx.x, row = blockIdx.y, i = blockIdx.z;
    if (t >= scan->width)
        return;
    const Samples pair = samples[t];
    const size_t view_size = (size_t)scan->rows * scan->columns;
    float value = 0.0f;
    for (int k = 0; k < 2; k++) {
        const int spot = pair.spot[k], last = (scan->views - 1 - spot) / scan->spots;
        const double number = (view_of_angle[first + i] - pair.views_earlier[k] - spot) / scan->spots;
        int low = (int)floor(number), high;
        float share = (float)(number - low);
        if (scan->periodic) {
            low = (low % (last + 1) + last + 1) % (last + 1);
            high = (low + 1) % (last + 1);
        } else {
            low = low < 0 ? 0 : low > last ? last : low;
            high = low < last ? low + 1 : last;
            share = (float)fmin(fmax(number - low, 0.0), 1.0);
        }
        const size_t pixel = (size_t)row * scan->columns + pair.column[k];
        const float earlier = projections[(low * scan->spots + spot) * view_size + pixel];
        const float later = projections[(high * scan->spots + spot) * view_size + pixel];
        value += pair.weight[k] * cone_cosine[spot * view_size + pixel] * (earlier * (1.0f - share) + later * share);
    }
    images[((size_t)i * scan->rows + row) * padded + t] = value;
}

/* Compute the mean over directions of the images' values at each voxel; 0 where a direction is missing. Views of one
   direction are averaged with their row weights. One thread per x, y and SLICES voxels along z. */
KERNEL back_project(float *volume, const float *images, const Direction *directions, const double *level_ahead,
                    const Scan *scan, const double *x_mm, const double *y_mm, double lowest_z, double z_spacing,
                    int nx, int ny, int nz)
{
    const int column = blockIdx.x * blockDim.x + threadIdx.x, line = blockIdx.y, first = blockIdx.z * SLICES;
    if (column >= nx)
        return;
    const int width = scan->width, rows = scan->rows;
    const double x = x_mm[column], y = y_mm[line];
    const float middle = (rows - 1) * 0.5f, half = rows > 1 ? (rows - 1) * 0.5f : 0.5f;
    const float falloff = 1.0f / (float)(1.0 - scan->full);
    float mean[SLICES] = {0.0f};
    int seen[SLICES] = {0};
    for (int direction = 0; direction < scan->half_turn; direction++) {
        float total[SLICES] = {0.0f}, sum[SLICES] = {0.0f};
        for (int level = 0; level < scan->levels; level++) {
            for (int angle = direction; angle < scan->angles; angle += scan->half_turn) {
                const size_t image = (size_t)level * scan->angles + angle;
                const Direction ray = directions[image];
                const double t = x * ray.cosine + y * ray.sine, across = (t - scan->first_t) / scan->t_pitch;
                if (across < 0.0 || across > width - 1 || fabs(t) >= ray.radius)
                    continue;
                const int j = across < width - 2 ? (int)across : width - 2;
                const float right = (float)(across - j);
                const double *const at_t = level_ahead + (size_t)level * width + j;
                const double ahead = at_t[0] + (across - j) * (at_t[1] - at_t[0]);
                const double fan_sine = t / ray.radius, fan_cosine = sqrt(1.0 - fan_sine * fan_sine);
                const double depth = ray.radius * fan_cosine + x * ray.sine - y * ray.cosine;
                const double magnification = ahead / (fan_cosine * depth);
                const double source_z = ray.source_z - asin(fan_sine) * scan->rise;
                const double bottom = (lowest_z + first * z_spacing - source_z) * magnification + ray.up;
                const float height = (float)((bottom - scan->first_row) / scan->row_pitch);
                const float slope = (float)(magnification * z_spacing / scan->row_pitch);
                for (int i = 0; i < SLICES; i++) {
                    const float at = height + slope * i; /* in rows from row 0 */
                    float share = (1.0f - fabsf(at - middle) / half) * falloff;
                    share = share < 1.0f ? share : 1.0f;
                    if (!(share > 0.0f))
                        continue;
                    share *= share * (3.0f - 2.0f * share);
                    const int k = rows > 1 ? ((int)at < rows - 2 ? (int)at : rows - 2) : 0;
                    const float above = rows > 1 ? at - k : 0.0f;
                    const float *const low = images + (image * rows + k) * width + j;
                    const float *const high = rows > 1 ? low + width : low;
                    total[i] += share;
                    sum[i] += share * ((1.0f - above) * ((1.0f - right) * low[0] + right * low[1])
                                       + above * ((1.0f - right) * high[0] + right * high[1]));
                }
            }
        }
        for (int i = 0; i < SLICES; i++) {
            if (total[i] > 0.0f) {
                mean[i] += sum[i] / total[i];
                seen[i]++;
            }
        }
    }
    for (int i = 0; i < SLICES && first + i < nz; i++)
        volume[((size_t)(first + i) * ny + line) * nx + column] =
            seen[i] == scan->half_turn ? mean[i] / scan->half_turn : 0.0f;
}
"""
)
# The structures of the source.
SCAN = np.dtype(
    [(name, np.int32) for name in ("views", "rows", "columns", "spots", "periodic", "width", "angles", "levels")]
    + [("half_turn", np.int32)]
    + [(name, np.float64) for name in ("first_t", "t_pitch", "first_row", "row_pitch", "rise", "full")],
    align=True,
)
SAMPLES = np.dtype(
    [("views_earlier", "f8", 2), ("weight", "f4", 2), ("spot", "i4", 2), ("column", "i4", 2)], align=True
)
DIRECTION = np.dtype([(name, np.float64) for name in ("sine", "cosine", "radius", "up", "source_z")], align=True)

THREADS = 64  # per block, along t or x
ROWS_AT_ONCE = 1 << 14  # of rebinned images: 60 MB in the default study, and several times as much during the filter


def device_arrays() -> ModuleType:
    """Return the array module of the device, CuPy.

    Raises
    ------
    InputError
        Without a CUDA device or CuPy.
    """
    check_device()
    import cupy

    return cupy


@lru_cache(maxsize=1)
def _kernels(arrays):
    return arrays.RawModule(code=SOURCE)


def _launch(arrays, name, count, rows, layers, arguments):
    """Run a kernel with one thread for each of `count`, `rows` and `layers`."""
    _kernels(arrays).get_function(name)((-(-count // THREADS), rows, layers), (THREADS, 1, 1), arguments)


def _on_device(arrays, values: np.ndarray):
    """Copy an array to the device; structures as bytes, because CuPy has no arrays of structures."""
    values = np.ascontiguousarray(values)
    return arrays.asarray(values if values.dtype.fields is None else values.view(np.uint8))


@contextmanager
def memory_errors():
    """Report that the device's memory is full (CuPy raises a MemoryError) as an InputError."""
    try:
        yield
    except MemoryError as error:
        raise InputError(
            f"engine: astra_cuda: {' '.join(str(error).split())}; free the device's memory, make the grid or the scan "
            "smaller, or set engine: cpu"
        ) from error


def _scan_table(rays: ParallelRays, full_rows: float = 0.0) -> np.ndarray:
    orbit = rays.geometry
    source_step = orbit.source_z_mm[1] - orbit.source_z_mm[0]
    values = (
        *(orbit.views, orbit.rows, orbit.columns, len(orbit.spots_mm), rays.periodic),
        *(len(rays.t_mm), len(rays.angles_rad), rays.levels, rays.half_turn),
        *(rays.t_mm[0], rays.t_pitch_mm, orbit.row_positions_mm()[0], orbit.row_pitch_mm),
        *(source_step / rays.view_step, full_rows),
    )
    return np.array([values], SCAN)


def _sample_table(rays: ParallelRays, level: int) -> np.ndarray:
    samples = rays.interleaved[level]
    table = np.empty(len(rays.t_mm), SAMPLES)
    table["views_earlier"] = np.stack(samples.fan_rad, axis=-1) / rays.view_step
    table["weight"] = np.stack([1 - samples.right_share, samples.right_share], axis=-1) * samples.known[:, None]
    table["spot"], table["column"] = np.stack(samples.spot, axis=-1), np.stack(samples.column, axis=-1)
    return table


def _direction_table(rays: ParallelRays) -> np.ndarray:
    source_z = rays.geometry.source_z_mm
    table = np.empty((rays.levels, len(rays.angles_rad)), DIRECTION)
    table["sine"], table["cosine"] = np.sin(rays.angles_rad), np.cos(rays.angles_rad)
    table["radius"], table["up"] = rays.level_radius_mm[:, None], rays.level_z_mm[:, None]
    view = rays.view_of_angle - rays.level_turn_rad[:, None] / rays.view_step
    table["source_z"] = source_z[0] + rays.level_z_mm[:, None] + view * (source_z[1] - source_z[0])
    return table


def rebin(rays: ParallelRays, line_integrals: np.ndarray, padded: int) -> Iterator[tuple[slice, object]]:
    """Weight projections by the cosine of the cone angle, and interpolate them to parallel rays on the device.

    Parameters
    ----------
    line_integrals : ndarray, shape (views, rows, columns)
    padded : int
        Length of the rows; zeros follow the distances t.

    Yields
    ------
    images : slice
        Numbers of the next images, level x angles + angle.
    block : device array, shape (images, rows, padded)
        Overwritten by the next block.
    """
    arrays, angles, rows = device_arrays(), len(rays.angles_rad), rays.geometry.rows
    projections, cosine = (
        _on_device(arrays, np.asarray(values, np.float32)) for values in (line_integrals, rays.cone_cosine)
    )
    view_of_angle, scan = _on_device(arrays, rays.view_of_angle), _on_device(arrays, _scan_table(rays))
    at_once = max(1, ROWS_AT_ONCE // rows)
    block = arrays.zeros((min(at_once, angles), rows, padded), dtype=np.float32)
    for level in range(rays.levels):
        samples = _on_device(arrays, _sample_table(rays, level))
        for first in range(0, angles, at_once):
            part = block[: min(at_once, angles - first)]
            arguments = (part, projections, cosine, view_of_angle, samples, scan, np.int32(first), np.int32(padded))
            _launch(arrays, "rebin", len(rays.t_mm), rows, len(part), arguments)
            start = level * angles + first
            yield slice(start, start + len(part)), part


class ParallelCudaProjector:
    """`back_parallel` and `unpack_volume` of cpu.CpuProjector on a CUDA device.

    Packed volumes are [lane, z, y, x], and packed projections [lane, level and angle, row, t], float32. There is
    one of each for every filter, in a list.

    Parameters
    ----------
    centre_mm : array_like, shape (3,), optional
        Center of the grid relative to the isocenter (x, y, z), mm.

    Raises
    ------
    InputError
        If the grid's corners are outside the source's orbit, or without a CUDA device or CuPy.
    """

    engine = "astra_cuda"

    def __init__(self, geometry: ScanGeometry, grid: Grid, centre_mm: ArrayLike = (0.0, 0.0, 0.0)):
        check_in_orbit(geometry, grid, centre_mm)
        self.geometry, self.grid, self.centre_mm = geometry, grid, np.asarray(centre_mm, dtype=np.float64)
        self._arrays = device_arrays()

    def back_parallel(self, projections: Sequence, rays: ParallelRays, full_rows: float) -> list:
        """See cpu.CpuProjector.back_parallel."""
        nz, ny, nx = self.grid.shape
        centre_x, centre_y, centre_z = self.centre_mm
        z, y, x = (axis + at for axis, at in zip(self.grid.axes_mm(), (centre_z, centre_y, centre_x), strict=True))
        tables = (_direction_table(rays), rays.level_ahead_mm, _scan_table(rays, full_rows), x, y)
        arguments = (
            *(_on_device(self._arrays, table) for table in tables),
            *(np.float64(z[0]), np.float64(self.grid.spacing[0]), np.int32(nx), np.int32(ny), np.int32(nz)),
        )
        volumes = []
        for images in projections:
            with memory_errors():
                volume = self._arrays.zeros((len(images), nz, ny, nx), dtype=np.float32)
            for lane, of_lane in enumerate(images):
                _launch(self._arrays, "back_project", nx, ny, -(-nz // SLICES), (volume[lane], of_lane, *arguments))
            volumes.append(volume)
        return volumes

    def unpack_volume(self, packed) -> np.ndarray:
        """Copy [lane, z, y, x] from the device."""
        return self._arrays.asnumpy(packed)
