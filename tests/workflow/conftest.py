import fcntl
import json
import shutil

import pytest
from workflow_runs import tiny


@pytest.fixture(scope="session")
def made_once(tmp_path_factory, worker_id):
    """Folder that all workers share: the tiny study in `results`, a copy of it in `kept`, and its output in `said`.

    The first worker runs it on two cores; the others wait.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "tiny"
    folder.mkdir(exist_ok=True)
    with open(folder / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "said").exists():
            process = tiny(folder / "results")
            assert process.returncode == 0, process.stderr[-4000:]
            shutil.copytree(folder / "results", folder / "kept")
            (folder / "said").write_text(json.dumps(process.stdout + process.stderr))
    return folder


@pytest.fixture(scope="session")
def study(made_once):
    """Folder of the tiny study, for reading and copying; only test_workflow.py changes it, in its own copy."""
    return made_once / "kept"
