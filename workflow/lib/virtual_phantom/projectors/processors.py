"""Instruction sets that the kernels are compiled for."""

from numba import config
from numba.core.codegen import get_host_cpu_features

AVX512, AVX2, ANY = KINDS = ("AVX-512", "AVX2", "any")


def kind_of(features: str) -> str:
    """Return the instruction set of a processor from LLVM's names of its features, such as "+avx2,-avx512f"."""
    given = features.split(",")
    return AVX512 if "+avx512f" in given else AVX2 if "+avx2" in given else ANY


# Instruction set that numba compiles for in this process.
PROCESSOR = kind_of(get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES)
