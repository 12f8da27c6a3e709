"""Projection engines. Each is a class with the methods of cpu.CpuProjector: pack_*, unpack_*, forward and back."""

from __future__ import annotations

import warnings

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from ..base.vectors import FLAT

ENGINES = ("auto", "cpu", "astra_cuda")


def cuda_available() -> bool:
    """Return whether ASTRA can use a CUDA device. Without a device, ASTRA's 3D algorithms end the process."""
    import astra

    return bool(astra.use_cuda())


def cupy_installed() -> bool:
    """Return whether CuPy can be imported; astra_cuda keeps its arrays on the device with it."""
    try:
        import cupy  # noqa: F401
    except ImportError:  # CuPy, or a library that it needs, is missing
        return False
    return True


UNSUPPORTED_BY_ASTRA = "engine: astra_cuda supports neither cylindrical detectors nor parallel beams; set engine: cpu"
NO_CUPY = "astra_cuda needs CuPy, which cannot be imported: pip install -r environment-gpu.txt"


def astra_projects(geometry: ScanGeometry) -> bool:
    """Return whether ASTRA supports the scan: a flat detector and a beam that is not parallel."""
    return geometry.surface == FLAT and not geometry.parallel


def choose_engine(name: str, backprojector: str, check: bool = True, flat: bool = True) -> str:
    """Return the engine for the configured name; "auto" selects CUDA where it is available and supports the scan.

    Warns if CUDA is available but unused because CuPy is missing.

    Parameters
    ----------
    backprojector : {"voxel", "adjoint"}
        Back-projector of SIRT; ASTRA has no "adjoint".
    check : bool, optional
        False: do not check for a device if the name is astra_cuda; `projector` checks it later.
    flat : bool, optional
        Whether ASTRA supports the scan: all detectors are flat and no beam is parallel.

    Raises
    ------
    InputError
        For an unknown engine, or astra_cuda without a CUDA device or CuPy, with "adjoint", a curved detector or a
        parallel beam.
    """
    if name not in ENGINES:
        raise InputError(f"engine '{name}' is unknown; use one of {', '.join(ENGINES)}")
    if name == "cpu" or (name == "auto" and (backprojector == "adjoint" or not flat)):
        return "cpu"
    if not flat:
        raise InputError(UNSUPPORTED_BY_ASTRA)
    if backprojector == "adjoint":
        raise InputError("engine: astra_cuda has no adjoint; set reconstruction.sirt.backprojector: voxel")
    if name == "auto":
        if not cuda_available():
            return "cpu"
        if cupy_installed():
            return "astra_cuda"
        warnings.warn(f"engine: auto uses the CPU although a CUDA device is available: {NO_CUPY}", stacklevel=2)
        return "cpu"
    if check:
        _check_device()
    return "astra_cuda"


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
    _check_device()
    from .astra_cuda import AstraCudaProjector

    return AstraCudaProjector(geometry, grid, lanes)


def _check_device():
    if not cuda_available():
        raise InputError("engine: astra_cuda needs a CUDA device, but ASTRA finds none; set engine: cpu or auto")
    if not cupy_installed():
        raise InputError(f"engine: {NO_CUPY}; or set engine: cpu")
