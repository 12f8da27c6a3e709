"""Filtered back-projection of circular and helical cone-beam scans with a ramp filter."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import chain

import numpy as np
from scipy import fft

from ..base.errors import InputError
from ..base.geometry import ScanGeometry, orbit_of
from ..base.parallel_rays import ParallelRays
from ..base.vectors import FLAT
from ..projectors import NO_FDK, parallel_cuda
from ..projectors.cpu import parallel_stack
from .kernel import Kernel, ModifiedKernel, NoiseKernel, modified

# Central fraction of the detector rows with full weight where views of one direction overlap.
FULL_ROWS = 0.6


def fbp(
    projector, line_integrals: np.ndarray, *, normalise: str = "coverage", kernel: Kernel | ModifiedKernel | None = None
) -> np.ndarray:
    """Return the linear attenuation, 1/mm, by filtered back-projection.

    Parameters
    ----------
    line_integrals : ndarray, shape (lanes, views, rows, columns)
    normalise : {"coverage", "none"}, optional
        "coverage": weighted filtered back-projection [1]_. Rays are rebinned to parallel rays, and every voxel receives
        each direction (modulo half a turn) once; views of one direction are averaged with their row weights. Voxels
        outside the field of view, or without a complete set of directions, are air. "none": FDK [2]_ as if all views
        were one turn. It is correct for one circular turn. On a helix, voxels are scaled by the fraction of views that
        see them, as with ASTRA's FDK_CUDA.
    kernel : Kernel, optional
        None: the ramp filter without apodization.

    Returns
    -------
    ndarray, shape (lanes, z, y, x)

    Raises
    ------
    InputError
        For an unknown `normalise`, or a scan that is neither circular nor helical. With "coverage" also for a scan that
        ParallelRays refuses, with "none" for a kernel, a curved detector, a flying focal spot or another engine than
        the CPU.

    References
    ----------
    .. [1] K. Stierstorfer et al., Phys. Med. Biol. 49, 2209, 2004.
    .. [2] Feldkamp, Davis and Kress, J. Opt. Soc. Am. A 1, 612, 1984.
    """
    if normalise == "none":
        if kernel is not None:
            raise InputError("fbp: a kernel needs reconstruction.fbp.normalise: coverage")
        return _fdk(projector, line_integrals)
    if normalise == "coverage":
        return ParallelProjections.of(line_integrals, projector.geometry, kernel, projector.engine).back(projector)
    raise InputError(f"fbp: reconstruction.fbp.normalise '{normalise}' is unknown; use 'coverage' or 'none'")


def _fdk(projector, line_integrals):
    if projector.engine != "cpu":
        raise InputError(NO_FDK)
    geometry = orbit_of(projector.geometry, "filtered back-projection")
    if geometry.surface != FLAT or geometry.has_focal_spot_offset:
        odd = "a flying focal spot" if geometry.surface == FLAT else f"a {geometry.surface} detector"
        raise InputError(f"fbp: FDK does not support {odd}; set reconstruction.fbp.normalise: coverage")
    u, v = geometry.column_positions_mm(), geometry.row_positions_mm()
    distance = geometry.source_to_detector_mm
    cosine = (distance / np.sqrt(distance**2 + u[None, :] ** 2 + v[:, None] ** 2)).astype(np.float32)
    filtered = np.empty(line_integrals.shape, dtype=np.float32)
    for lane, stack in enumerate(line_integrals):
        filtered[lane] = ramp_filter(stack * cosine, geometry.column_pitch_mm / geometry.magnification)
    volume = projector.back(projector.pack_projections(filtered))
    # Half of the integral over one turn, because each ray is measured twice.
    volume *= np.float32(np.pi / geometry.views)
    return projector.unpack_volume(volume)


class ParallelProjections:
    """Projections rebinned to parallel rays and filtered, in the layout of the engine's `back_parallel`."""

    def __init__(self, rays: ParallelRays, packed, lanes: int, engine: str):
        self.rays, self.packed, self.lanes, self.engine = rays, packed, lanes, engine

    @classmethod
    def of(
        cls,
        line_integrals: np.ndarray,
        geometry: ScanGeometry,
        kernel: Kernel | ModifiedKernel | None = None,
        engine: str = "cpu",
    ) -> ParallelProjections:
        """Rebin and filter line integrals, (lanes, views, rows, columns); without a kernel, the ramp is not apodized.

        Raises
        ------
        InputError
            For the scans that ParallelRays refuses, or astra_cuda without a device or with too little memory.
        """
        rays = ParallelRays(geometry)
        if engine != "cpu":
            return cls(rays, _filtered_on_device(rays, line_integrals, kernel), len(line_integrals), engine)
        packed = parallel_stack(rays, len(line_integrals))
        for lane, stack in enumerate(line_integrals):
            stack = rays.weighted_by_cone_angle(stack)
            first = 0
            for images in chain.from_iterable(rays.rebin(stack, level) for level in range(rays.levels)):
                filtered = ramp_filter(images, rays.t_pitch_mm, kernel).swapaxes(1, 2)
                packed[first : first + len(images), 1:-1, 1:-1, lane] = filtered
                first += len(images)
        return cls(rays, packed, len(line_integrals), engine)

    def back(self, projector) -> np.ndarray:
        """Return the back-projection, 1/mm, (lanes, z, y, x). The projector's geometry and lanes must agree."""
        volume = projector.unpack_volume(projector.back_parallel(self.packed, self.rays, FULL_ROWS))
        # Projections are truncated outside this radius. Scanners also show air there.
        centre_x, centre_y, _ = projector.centre_mm
        _, y, x = projector.grid.axes_mm()
        y, x = y + centre_y, x + centre_x
        inside = np.hypot(y[:, None], x[None, :]) <= self.rays.geometry.field_of_view_radius_mm
        volume *= (np.pi * inside).astype(np.float32)
        return volume


def with_noise_kernel(
    line_integrals: np.ndarray,
    clean: np.ndarray,
    geometry: ScanGeometry,
    kernel: Kernel,
    noise_kernel: NoiseKernel,
    engine: str = "cpu",
    mtf: Callable[[np.ndarray], np.ndarray] | None = None,
) -> ParallelProjections:
    """Rebin and filter the object with one kernel and the noise with another one.

    Parameters
    ----------
    line_integrals : ndarray, shape (lanes, views, rows, columns)
    clean : ndarray, shape (views, rows, columns)
        Noise-free line integrals of all lanes.
    mtf : callable, optional
        Further factor of both kernels, as `modified` takes it.
    """
    rays = ParallelProjections.of(line_integrals - clean, geometry, modified(noise_kernel.kernel, mtf), engine)
    rays.packed *= np.float32(noise_kernel.gain(kernel))
    rays.packed += ParallelProjections.of(clean[None], geometry, modified(kernel, mtf), engine).packed
    return rays


def _filtered_on_device(rays, line_integrals, kernel):
    """Return [lane, image, row, t] of parallel_cuda.py."""
    arrays, samples = parallel_cuda.device_arrays(), len(rays.t_mm)
    n = _padded(samples)
    with parallel_cuda.memory_errors():
        ramp = arrays.asarray(_ramp(n, rays.t_pitch_mm, kernel))
        shape = (len(line_integrals), rays.levels * len(rays.angles_rad), rays.geometry.rows, samples)
        filtered = arrays.zeros(shape, dtype=np.float32)
        for lane, stack in enumerate(line_integrals):
            for images, block in parallel_cuda.rebin(rays, stack, n):
                spectrum = arrays.fft.rfft(block, axis=-1)
                spectrum *= ramp
                filtered[lane, images] = arrays.fft.irfft(spectrum, n, axis=-1)[..., :samples]
        return filtered


def ramp_filter(rows: np.ndarray, pitch_mm: float, kernel: Kernel | ModifiedKernel | None = None) -> np.ndarray:
    """Apply the ramp filter, per mm, along the last axis of samples at a distance of `pitch_mm`."""
    samples = rows.shape[-1]
    n = _padded(samples)
    spectrum = fft.rfft(rows.astype(np.float32, copy=False), n, axis=-1) * _ramp(n, pitch_mm, kernel)
    return fft.irfft(spectrum, n, axis=-1)[..., :samples]


def _padded(samples):
    """Return the length of the transforms: a convolution must not wrap around."""
    return fft.next_fast_len(2 * samples, real=True)


@lru_cache(maxsize=4)
def _ramp(n: int, pitch_mm: float, kernel: Kernel | ModifiedKernel | None = None) -> np.ndarray:
    """Return the ramp at the frequencies of a real transform of n samples, shape (n // 2 + 1,).

    It is the transform of the band-limited impulse response, which preserves the mean.

    References
    ----------
    Kak and Slaney, Principles of Computerized Tomographic Imaging, 1988, eq. 3.61.
    """
    offset = np.minimum(np.arange(n), n - np.arange(n))
    response = np.where(offset % 2 == 1, -1 / (np.pi * np.maximum(offset, 1) * pitch_mm) ** 2, 0.0)
    response[0] = 1 / (4 * pitch_mm**2)
    ramp = fft.rfft(response).real * pitch_mm
    if kernel is not None:
        ramp *= kernel.window(fft.rfftfreq(n, pitch_mm), pitch_mm)
    return ramp.astype(np.float32)
