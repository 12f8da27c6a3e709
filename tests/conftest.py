import os
import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

# Tests start Python hundreds of times; without cached bytecode, each start would compile the library.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Linear algebra threads busy-wait for each other. With several workers this takes longer than the work.
if "PYTEST_XDIST_WORKER" in os.environ:
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

# No test asserts a time: on a loaded machine, an example may take any time.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# Files that take longest, longest first. If one started last, it would keep a single worker busy.
LONGEST = (
    "workflow/test_workflow.py",
    "workflow/test_diagnosis_target.py",
    "workflow/test_marked_pages.py",
    "workflow/test_proof_target.py",
    "recordings/test_recordings_alignment.py",
    "diagnosis/test_object_differs.py",
    "workflow/test_comparison.py",
    "projectors/test_processors.py",
    "workflow/test_printed_phantom.py",
    "diagnosis/test_setup.py",
    "diagnosis/test_images.py",
    "workflow/test_off_centre_ct.py",
    "workflow/test_diagnosis_of_images.py",
    "workflow/test_fetch.py",
    "workflow/test_elsewhere.py",
    "test_notebooks.py",
    "test_solvers.py",
    "test_package.py",
    "study/test_init.py",
)
HERE = Path(__file__).parent


def pytest_configure(config):
    # By default, xdist starts with the files that have most tests, which are short.
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Order the files for the workers of `pytest -n --dist loadfile`: LONGEST, others of the workflow, the rest."""
    places = {HERE / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (places.get(item.path, len(places)), HERE / "workflow" not in item.path.parents))
