from pathlib import Path

import pytest
from workflow_runs import tiny

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Tests of the workflow take longest: workers of `pytest -n --dist loadfile` begin with them."""
    items.sort(key=lambda item: HERE not in item.path.parents)


@pytest.fixture(scope="session")
def study_run(tmp_path_factory):
    """The tiny study, run for real on two cores: its folder, and what was said."""
    folder = tmp_path_factory.mktemp("study") / "results"
    process = tiny(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder, process.stdout + process.stderr


@pytest.fixture(scope="session")
def study(study_run):
    """The folder of the tiny study."""
    return study_run[0]
