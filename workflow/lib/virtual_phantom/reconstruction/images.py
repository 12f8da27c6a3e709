"""Reconstruct images in HU from line integrals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry, circular
from ..base.settings import FbpSettings, SirtSettings
from ..base.units import attenuation_to_hu
from ..projectors import in_parts, parallel_projector, projector
from . import fbp, sirt
from .kernel import Kernel, NoiseKernel


def reconstruct_hu(
    line_integrals: np.ndarray,
    geometry: ScanGeometry,
    grid: Grid,
    algorithm: str,
    settings: SirtSettings | FbpSettings,
    engine: str,
    mu_water_per_mm: float,
    threads: int = 1,
    clean: np.ndarray | None = None,
    mtf: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Return images of every acquisition in HU, not rounded.

    Parameters
    ----------
    line_integrals : ndarray, shape (acquisitions, views, rows, columns)
    algorithm : {"sirt", "fbp"}
    engine : {"cpu", "astra_cuda"}
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.
    clean : ndarray, shape (views, rows, columns), optional
        Noise-free line integrals of all acquisitions, for a noise kernel.
    mtf : callable, optional
        Further factor of the kernel, if the algorithm `filters_projections`: frequencies in cycles per mm to a factor.

    Returns
    -------
    ndarray, shape (acquisitions, z, y, x)

    Raises
    ------
    InputError
        For an unknown algorithm, or a scan or setting that it or the engine does not support.
    """
    at_once = len(line_integrals) if engine == "cpu" else 1
    if algorithm == "sirt":
        operator = projector(engine, geometry, grid, at_once, threads)

        def images(some):
            return sirt.sirt(operator, some, **vars(settings), mu_water_per_mm=mu_water_per_mm)

    elif algorithm == "fbp":
        operator = parallel_projector(engine, geometry, grid, at_once, threads)

        def images(some):
            if settings.normalise == "coverage":
                (image,) = filtered(some, geometry, [settings], clean, engine, mtf).back(operator)
                return image
            return fbp.fbp(operator, some, normalise=settings.normalise, kernel=kernel_of(settings))

    else:
        raise InputError(f"algorithm '{algorithm}' is unknown; use sirt or fbp")
    return attenuation_to_hu(in_parts(engine, images, line_integrals), mu_water_per_mm)


def filters_projections(algorithm: str, settings: SirtSettings | FbpSettings) -> bool:
    """Whether an algorithm filters projections with a kernel of choice."""
    return algorithm == "fbp" and settings.normalise == "coverage"


def filtered(
    line_integrals: np.ndarray,
    geometry: ScanGeometry,
    settings: Sequence[FbpSettings],
    clean: np.ndarray | None = None,
    engine: str = "cpu",
    mtf: Callable[[np.ndarray], np.ndarray] | None = None,
) -> fbp.ParallelProjections:
    """Return projections rebinned and filtered by each of the settings, from which several images may be made.

    Parameters
    ----------
    line_integrals : ndarray, shape (acquisitions, views, rows, columns)
    settings : sequence of FbpSettings
        Only the kernels are used.
    clean : ndarray, shape (views, rows, columns), optional
        Noise-free line integrals of all acquisitions, for noise kernels.
    engine : {"cpu", "astra_cuda"}, optional
    mtf : callable, optional
        As `reconstruct_hu` takes it.

    Raises
    ------
    InputError
        For the scans that ParallelProjections.of refuses.
    """
    filters = [fbp.Filter.of(kernel_of(one), noise_kernel_of(one), mtf) for one in settings]
    return fbp.ParallelProjections.of(line_integrals, geometry, filters, clean, engine)


def noise_kernel_of(settings: FbpSettings) -> NoiseKernel | None:
    """Return the kernel of the noise alone; None if noise and object have the same kernel."""
    if settings.noise_kernel is None:
        return None
    known = settings.noise_kernel
    return NoiseKernel(Kernel(known.mtf50_per_cm, known.mtf10_per_cm), known.variance)


def kernel_of(settings: FbpSettings) -> Kernel | None:
    """Return the reconstruction kernel of filtered back-projection; None for the ramp filter alone."""
    return None if settings.kernel is None else Kernel(**vars(settings.kernel))


def compile_functions(step: str, lanes: int, method: str | None = None) -> None:
    """Compile the Numba functions of a step for a number of realizations; later processes load them from the cache.

    Parameters
    ----------
    step : {"project", "sirt", "fbp"}
    method : str, optional
        `backprojector` of SIRT or `normalise` of FBP.
    """
    geometry = circular(
        views=4,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=4,
        rows=2,
        column_pitch_mm=1.0,
        row_pitch_mm=1.0,
    )
    grid = Grid((2, 2, 2), (1.0, 1.0, 1.0))
    operator, scan = projector("cpu", geometry, grid, lanes), np.ones((lanes, 4, 2, 4), dtype=np.float32)
    if step == "sirt":
        sirt.sirt(operator, scan, iterations=1, solver="chebyshev", terms=1, backprojector=method)
    elif step == "fbp":
        fbp.fbp(operator, scan, normalise=method)
    else:
        operator.forward(operator.empty_volume())
