import pytest
from workflow_runs import tiny


@pytest.fixture(scope="session")
def study(tmp_path_factory):
    """The tiny study, run for real on two cores."""
    folder = tmp_path_factory.mktemp("study") / "results"
    process = tiny(folder)
    assert process.returncode == 0, process.stderr[-4000:]
    return folder
