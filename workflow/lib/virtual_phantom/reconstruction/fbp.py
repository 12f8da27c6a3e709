"""Filtered back-projection of circular and helical cone-beam scans with a ramp filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from ..base.errors import InputError
from ..base.geometry import ScanGeometry, orbit_of
from ..base.parallel_rays import ParallelRays
from ..base.vectors import FLAT
from ..projectors import NO_FDK, parallel, parallel_cuda
from ..projectors.cpu import parallel_stacks
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
        scan = line_integrals, projector.geometry
        (image,) = ParallelProjections.of(*scan, [Filter(kernel)], engine=projector.engine).back(projector)
        return image
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


@dataclass(frozen=True)
class Filter:
    """Kernels of filtered back-projection.

    Attributes
    ----------
    kernel : Kernel, ModifiedKernel or None
        Kernel of the object; None: the ramp filter without apodization.
    noise : Kernel, ModifiedKernel or None
        Kernel of the noise, if it has another one.
    gain : float
        Factor of the noise with its own kernel.
    """

    kernel: Kernel | ModifiedKernel | None = None
    noise: Kernel | ModifiedKernel | None = None
    gain: float = 1.0

    @classmethod
    def of(
        cls,
        kernel: Kernel | None,
        noise_kernel: NoiseKernel | None = None,
        mtf: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> Filter:
        """Return the filter of a kernel and a noise kernel, both times a factor of the MTF as `modified` takes it."""
        if noise_kernel is None:
            return cls(modified(kernel, mtf))
        return cls(modified(kernel, mtf), modified(noise_kernel.kernel, mtf), noise_kernel.gain(kernel))


class ParallelProjections:
    """Projections rebinned to parallel rays and filtered.

    The first axis of `packed` is that of the filters: an array on the CPU, a list of device arrays on a GPU.
    """

    def __init__(self, rays: ParallelRays, packed, lanes: int, engine: str):
        self.rays, self.packed, self.lanes, self.engine = rays, packed, lanes, engine

    @classmethod
    def of(
        cls,
        line_integrals: np.ndarray,
        geometry: ScanGeometry,
        filters: Sequence[Filter],
        clean: np.ndarray | None = None,
        engine: str = "cpu",
    ) -> ParallelProjections:
        """Rebin and filter line integrals.

        Parameters
        ----------
        line_integrals : ndarray, shape (lanes, views, rows, columns)
        clean : ndarray, shape (views, rows, columns), optional
            Noise-free line integrals of all lanes, for filters with a kernel of the noise.

        Raises
        ------
        InputError
            For the scans that ParallelRays refuses, or astra_cuda without a device or with too little memory.
        """
        rays = ParallelRays(geometry)
        made = _filtered if engine == "cpu" else _filtered_on_device
        return cls(rays, made(rays, line_integrals, filters, clean), len(line_integrals), engine)

    def of_filters(self, which: slice) -> ParallelProjections:
        """Return the projections of some of the filters, without a copy."""
        return ParallelProjections(self.rays, self.packed[which], self.lanes, self.engine)

    def back(self, projector) -> np.ndarray:
        """Return back-projections, 1/mm, (filters, lanes, z, y, x). The projector's geometry and lanes must agree."""
        packed = projector.back_parallel(self.packed, self.rays, FULL_ROWS)
        volumes = np.empty((len(packed), self.lanes, *projector.grid.shape), np.float32)
        for volume, own in zip(volumes, packed, strict=True):
            volume[...] = projector.unpack_volume(own)
        # Projections are truncated outside this radius. Scanners also show air there.
        centre_x, centre_y, _ = projector.centre_mm
        _, y, x = projector.grid.axes_mm()
        y, x = y + centre_y, x + centre_x
        inside = np.hypot(y[:, None], x[None, :]) <= self.rays.geometry.field_of_view_radius_mm
        volumes *= (np.pi * inside).astype(np.float32)
        return volumes


def _filtered(rays, line_integrals, filters, clean):
    """Return rebinned and filtered projections in the layout of `cpu.parallel_stacks`."""
    samples = len(rays.t_mm)
    n = _padded(samples)

    def ramp(kernel):
        return _ramp(n, rays.t_pitch_mm, kernel)

    def spectra(stack):
        return (fft.rfft(one, n, axis=-1) for one in parallel.rebin(rays, np.ascontiguousarray(stack, np.float32)))

    packed = parallel_stacks(rays, len(filters), len(line_integrals))
    ramps = [(ramp(one.kernel), None if one.noise is None else one.gain * ramp(one.noise)) for one in filters]
    stacks = list(line_integrals)
    if any(of_noise is not None for _, of_noise in ramps):
        stacks.append(clean)
    first = 0
    for found in zip(*map(spectra, stacks), strict=True):
        own = slice(first, first + len(found[0]))
        for stack, (of_object, of_noise) in zip(packed, ramps, strict=True):
            # The filter of the noise applies to the difference from the noise-free projections, the last ones.
            rest = 0 if of_noise is None else found[-1] * (of_object - of_noise)
            for lane in range(len(line_integrals)):
                spectrum = found[lane] * (of_object if of_noise is None else of_noise) + rest
                stack[own, 1:-1, 1:-1, lane] = fft.irfft(spectrum, n, axis=-1)[..., :samples].swapaxes(1, 2)
        first = own.stop
    return packed


def _filtered_on_device(rays, line_integrals, filters, clean):
    """Return [lane, image, row, t] of parallel_cuda.py for each filter."""
    packed = []
    for one in filters:
        if one.noise is None:
            packed.append(_convolved_on_device(rays, line_integrals, one.kernel))
        else:
            noise = _convolved_on_device(rays, line_integrals - clean, one.noise)
            noise *= np.float32(one.gain)
            noise += _convolved_on_device(rays, clean[None], one.kernel)
            packed.append(noise)
    return packed


def _convolved_on_device(rays, line_integrals, kernel):
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
