import os
import sys
from pathlib import Path

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

# Files that take longest, the longest first: handed out at the end, one would keep a worker busy alone.
LONGEST = (
    "workflow/test_workflow.py",
    "workflow/test_diagnosis_target.py",
    "workflow/test_proof_target.py",
    "recordings/test_recordings_alignment.py",
    "workflow/test_marked_pages.py",
    "workflow/test_comparison.py",
    "workflow/test_printed_phantom.py",
    "projectors/test_processors.py",
    "diagnosis/test_images.py",
    "workflow/test_off_centre_ct.py",
    "workflow/test_fetch.py",
    "workflow/test_diagnosis_of_images.py",
    "workflow/test_elsewhere.py",
    "test_notebooks.py",
    "study/test_init.py",
)
HERE = Path(__file__).parent


def pytest_configure(config):
    # xdist would begin with the files of most tests, which are short.
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Workers of `pytest -n --dist loadfile` take files in this order: LONGEST, others of the workflow, the rest."""
    places = {HERE / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (places.get(item.path, len(places)), HERE / "workflow" not in item.path.parents))
