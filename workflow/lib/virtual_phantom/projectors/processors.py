"""Instruction sets that the kernels are compiled for, and how numba compiles for another one."""

from pathlib import Path

from numba import config
from numba.core.codegen import get_host_cpu_features

AVX512, AVX2, ANY = KINDS = ("AVX-512", "AVX2", "any")
# x86-64-v3, the lowest level with AVX2.
AVX2_FEATURES = "avx avx2 bmi bmi2 f16c fma lzcnt movbe popcnt sse3 ssse3 sse4.1 sse4.2"


def kind_of(features: str) -> str:
    """Return the instruction set of a processor from LLVM's names of its features, such as "+avx2,-avx512f"."""
    given = features.split(",")
    return AVX512 if "+avx512f" in given else AVX2 if "+avx2" in given else ANY


# Instruction set that numba compiles for in this process.
PROCESSOR = kind_of(get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES)


def available() -> tuple[str, ...]:
    """Return the instruction sets of this machine, the best first."""
    return KINDS[KINDS.index(kind_of(get_host_cpu_features())) :]


def environment(kind: str, kernels: Path) -> dict[str, str]:
    """Return environment variables of a process whose kernels are compiled for an instruction set of `available`.

    `kernels` is a folder for these kernels alone. For the machine's own instruction set only the folder is set, so that
    numba compiles as usual.
    """
    variables = {"NUMBA_CACHE_DIR": str(kernels)}
    if kind == available()[0]:
        return variables
    if kind == ANY:
        return variables | {"NUMBA_CPU_NAME": "generic"}
    listed = ",".join(f"+{feature}" for feature in AVX2_FEATURES.split())
    return variables | {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": listed}
