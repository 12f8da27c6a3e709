"""Engines that project. All offer the same calls (see cpu.CpuProjector): pack, unpack, forward, back."""

from __future__ import annotations

import warnings

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry
from ..base.vectors import FLAT

ENGINES = ("auto", "cpu", "astra_cuda")


def cuda_available() -> bool:
    """True if ASTRA can use a CUDA device. Its 3D algorithms end the process where it cannot: ask first."""
    import astra

    return bool(astra.use_cuda())


def cupy_installed() -> bool:
    """True if there is a CuPy that works, which keeps the arrays of astra_cuda on the device."""
    try:
        import cupy  # noqa: F401
    except ImportError:  # of its own libraries too
        return False
    return True


NOT_OF_ASTRA = "engine: astra_cuda has neither cylindrical detectors nor parallel beams; set engine: cpu"
NO_CUPY = "astra_cuda needs CuPy, which cannot be imported: pip install -r environment-gpu.txt"


def astra_projects(geometry: ScanGeometry) -> bool:
    """Whether ASTRA is given such a scan: its detector is flat, and its beam not parallel."""
    return geometry.surface == FLAT and not geometry.parallel


def choose_engine(name: str, backprojector: str, look: bool = True, flat: bool = True) -> str:
    """The engine for what the configuration says; "auto" takes CUDA where there is any and it can do the work.

    Warns if a device is left unused for want of CuPy.

    Parameters
    ----------
    name : {"auto", "cpu", "astra_cuda"}
    backprojector : {"voxel", "adjoint"}
        That of SIRT: ASTRA has no "adjoint".
    look : bool, optional
        False: astra_cuda is believed, and looked for by what uses it (`projector`).
    flat : bool, optional
        Whether all detectors are, and no beam is parallel: ASTRA is given nothing else.

    Returns
    -------
    {"cpu", "astra_cuda"}

    Raises
    ------
    InputError
        For an unknown engine, for astra_cuda where there is no CUDA device or no CuPy, with "adjoint", or for a
        detector that is not flat or a parallel beam.
    """
    if name not in ENGINES:
        raise InputError(f"engine '{name}' is unknown; use one of {', '.join(ENGINES)}")
    if name == "cpu" or (name == "auto" and (backprojector == "adjoint" or not flat)):
        return "cpu"
    if not flat:
        raise InputError(NOT_OF_ASTRA)
    if backprojector == "adjoint":
        raise InputError("engine: astra_cuda has no adjoint; set reconstruction.sirt.backprojector: voxel")
    if name == "auto":
        if not cuda_available():
            return "cpu"
        if cupy_installed():
            return "astra_cuda"
        warnings.warn(f"engine: auto takes the CPU, though there is a CUDA device: {NO_CUPY}", stacklevel=2)
        return "cpu"
    if look:
        _check_device()
    return "astra_cuda"


def projector(engine: str, geometry: ScanGeometry, grid: Grid, lanes: int = 1, threads: int = 1):
    """The projector of an engine.

    Parameters
    ----------
    engine : {"cpu", "astra_cuda"}
        See choose_engine.
    lanes : int, optional
        How many realisations at once.
    threads : int, optional
        Of the CPU engine.

    Raises
    ------
    InputError
        For astra_cuda where there is no CUDA device or no CuPy.
    """
    if engine == "cpu":
        from .cpu import CpuProjector

        return CpuProjector(geometry, grid, lanes, threads)
    _check_device()
    from .astra_cuda import AstraCudaProjector

    return AstraCudaProjector(geometry, grid, lanes)


def _check_device():
    if not cuda_available():
        raise InputError("engine: astra_cuda needs a CUDA device and ASTRA finds none; set engine: cpu or auto")
    if not cupy_installed():
        raise InputError(f"engine: {NO_CUPY}; or set engine: cpu")
