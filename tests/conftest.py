import os
import sys

from hypothesis import HealthCheck, settings

# Python starts hundreds of times in these tests: each time it would compile the library, were its bytecode not kept.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Threads of linear algebra wait for each other in busy loops. Beside other workers, that takes longer than the work.
if "PYTEST_XDIST_WORKER" in os.environ:
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

# No test asserts a time: on a loaded machine an example may take any.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")
