"""Projection engines. Each is a class with the methods of cpu.CpuProjector: pack_*, unpack_*, forward and back."""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from ..base.vectors import FLAT

ENGINES = ("auto", "cpu", "astra_cuda")


def cuda_available() -> bool:
    """Return whether ASTRA can use a CUDA device. Without a device, ASTRA's 3D algorithms end the process."""
    if "astra" not in sys.modules and not _driver_found():  # the import of ASTRA takes 0.1 s
        return False
    import astra

    return bool(astra.use_cuda())


def _driver_found() -> bool:
    """Return whether NVIDIA's driver is installed, without which there is no CUDA device."""
    try:
        ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return False
    return True


def cupy_installed() -> bool:
    """Return whether CuPy can be imported; astra_cuda keeps its arrays on the device with it."""
    try:
        import cupy  # noqa: F401
    except ImportError:  # CuPy, or a library that it needs, is missing
        return False
    return True


UNSUPPORTED_BY_ASTRA = "engine: SIRT on astra_cuda needs flat detectors and divergent beams; set engine: cpu"
NO_FDK = "engine: astra_cuda has no FDK; set engine: cpu or reconstruction.fbp.normalise: coverage"
NO_CUPY = "astra_cuda needs CuPy, which cannot be imported: pip install -r environment-gpu.txt"


def astra_projects(geometry: ScanGeometry) -> bool:
    """Return whether ASTRA supports the scan: a flat detector and a beam that is not parallel."""
    return geometry.surface == FLAT and not geometry.parallel


def choose_engine(
    name: str, backprojector: str | None = None, normalise: str | None = None, check: bool = True, flat: bool = True
) -> str:
    """Return the engine for the configured name; "auto" selects CUDA where it is available and supports all algorithms.

    Warns if CUDA is available but unused because CuPy is missing.

    Parameters
    ----------
    backprojector : {"voxel", "adjoint"}, optional
        Back-projector of SIRT; None: no image is made by SIRT. ASTRA has no "adjoint".
    normalise : {"coverage", "none"}, optional
        Normalization of FBP; None: no image is made by FBP. The kernels of FBP do not support "none".
    check : bool, optional
        False: do not check for a device if the name is astra_cuda; `projector` checks it later.
    flat : bool, optional
        Whether ASTRA supports the scan, which SIRT needs: all detectors are flat and no beam is parallel.

    Raises
    ------
    InputError
        For an unknown engine, or astra_cuda without a CUDA device or CuPy, for SIRT with "adjoint", a curved detector
        or a parallel beam, or for FBP with "none".
    """
    if name not in ENGINES:
        raise InputError(f"engine '{name}' is unknown; use one of {', '.join(ENGINES)}")
    unsupported = _unsupported(backprojector, normalise, flat)
    if name == "cpu" or (name == "auto" and unsupported):
        return "cpu"
    if unsupported:
        raise InputError(unsupported)
    if name == "auto":
        if not cuda_available():
            return "cpu"
        if cupy_installed():
            return "astra_cuda"
        warnings.warn(f"engine: auto uses the CPU although a CUDA device is available: {NO_CUPY}", stacklevel=2)
        return "cpu"
    if check:
        check_device()
    return "astra_cuda"


def _unsupported(backprojector, normalise, flat):
    """Return the message about what astra_cuda does not support; None if it supports everything."""
    if backprojector is not None and not flat:
        return UNSUPPORTED_BY_ASTRA
    if backprojector == "adjoint":
        return "engine: astra_cuda has no adjoint; set reconstruction.sirt.backprojector: voxel"
    return NO_FDK if normalise == "none" else None


def projector(engine: str, geometry: ScanGeometry, grid: Grid, lanes: int = 1, threads: int = 1):
    """Return the projector of an engine ("cpu" or "astra_cuda") for a number of realizations (`lanes`).

    Raises
    ------
    InputError
        For astra_cuda without a CUDA device or CuPy.
    """
    if engine == "cpu":
        from .cpu import CpuProjector

        return CpuProjector(geometry, grid, lanes, threads)
    check_device()
    from .astra_cuda import AstraCudaProjector

    return AstraCudaProjector(geometry, grid, lanes)


def parallel_projector(
    engine: str,
    geometry: ScanGeometry,
    grid: Grid,
    lanes: int = 1,
    threads: int = 1,
    centre_mm: ArrayLike = (0.0, 0.0, 0.0),
):
    """Return the projector of an engine with `back_parallel`, for filtered back-projection; see `projector`.

    Parameters
    ----------
    centre_mm : array_like, shape (3,), optional
        Center of the grid relative to the isocenter (x, y, z), mm.
    """
    if engine == "cpu":
        from .cpu import CpuProjector

        return CpuProjector(geometry, grid, lanes, threads, centre_mm)
    from .parallel_cuda import ParallelCudaProjector

    return ParallelCudaProjector(geometry, grid, centre_mm)


def in_parts(engine: str, reconstruct: Callable[[np.ndarray], np.ndarray], line_integrals: np.ndarray) -> np.ndarray:
    """Return reconstruct(line_integrals) of all realizations.

    On the CPU, all realizations are reconstructed together, one per lane of the vector registers, for speed. On a GPU
    this has no advantage and needs memory, so they are reconstructed one by one.
    """
    if engine == "cpu" or len(line_integrals) == 1:
        return reconstruct(line_integrals)
    return np.concatenate([reconstruct(one[None]) for one in line_integrals])


def check_device() -> None:
    """Check that astra_cuda can be used.

    Raises
    ------
    InputError
        Without a CUDA device or CuPy.
    """
    if not cuda_available():
        raise InputError("engine: astra_cuda needs a CUDA device, but ASTRA finds none; set engine: cpu or auto")
    if not cupy_installed():
        raise InputError(f"engine: {NO_CUPY}; or set engine: cpu")
