from pathlib import Path

import pytest
from workflow_runs import tiny

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Workflow tests share one study and the checkout: one worker of `pytest -n` runs them all, and first, since
    they take longest."""
    items.sort(key=lambda item: HERE not in item.path.parents)
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.xdist_group("workflow"))


@pytest.fixture(scope="session")
def study(tmp_path_factory):
    """The tiny study, run for real on two cores."""
    folder = tmp_path_factory.mktemp("study") / "results"
    process = tiny(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder
