"""Benchmarks and validation studies; each module except `common` is a scenario of `python -m benchmarks`."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
