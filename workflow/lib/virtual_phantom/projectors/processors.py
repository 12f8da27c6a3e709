"""Kinds of processors that the kernels are compiled for, and how numba is made to compile for another."""

from pathlib import Path

from numba import config
from numba.core.codegen import get_host_cpu_features

AVX512, AVX2, ANY = KINDS = ("AVX-512", "AVX2", "any")
# Of x86-64's third level, the least that has AVX2.
AVX2_FEATURES = "avx avx2 bmi bmi2 f16c fma lzcnt movbe popcnt sse3 ssse3 sse4.1 sse4.2"


def kind_of(features: str) -> str:
    """The kind of a processor by LLVM's names of its features.

    Parameters
    ----------
    features : str
        "+avx2,-avx512f" and so on.

    Returns
    -------
    {"AVX-512", "AVX2", "any"}
    """
    given = features.split(",")
    return AVX512 if "+avx512f" in given else AVX2 if "+avx2" in given else ANY


# What numba compiles for in this process.
PROCESSOR = kind_of(get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES)


def available() -> tuple[str, ...]:
    """The kinds whose instructions this machine has, its own first."""
    return KINDS[KINDS.index(kind_of(get_host_cpu_features())) :]


def environment(kind: str, kernels: Path) -> dict[str, str]:
    """Variables of a process whose kernels are compiled for a kind of processor that `available` names.

    Parameters
    ----------
    kind : {"AVX-512", "AVX2", "any"}
    kernels : Path
        A folder for the kernels of this kind alone.

    Returns
    -------
    dict of str to str
        This machine's own kind asks for the folder only, so that numba compiles as it does without any of them.
    """
    variables = {"NUMBA_CACHE_DIR": str(kernels)}
    if kind == available()[0]:
        return variables
    if kind == ANY:
        return variables | {"NUMBA_CPU_NAME": "generic"}
    listed = ",".join(f"+{one}" for one in AVX2_FEATURES.split())
    return variables | {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": listed}
