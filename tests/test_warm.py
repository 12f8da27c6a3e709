"""A forked Python with imported packages behaves like Python."""

import os
import signal
import subprocess
import sys
import time

import pytest
import warm

SCRIPT = """
import os, sys
print(sys.argv[1:], os.getcwd(), os.environ["GIVEN"], [path for path in sys.path if path.endswith("mine")], sys.path[0])
print(input(), file=sys.stderr)
import pandas
print(__name__, pandas.__version__)
sys.exit(int(sys.argv[1]))
"""


@pytest.fixture
def script(tmp_path):
    place = tmp_path / "script.py"
    place.write_text(SCRIPT)
    return place


@pytest.mark.parametrize("variables", [{}, {"NUMBA_CPU_NAME": "generic"}], ids=["forked", "with a Python of its own"])
def test_forked_python_behaves_like_python(script, tmp_path, variables):
    environment = os.environ | {"GIVEN": "a b", "PYTHONPATH": "mine"} | variables
    run = dict(cwd=tmp_path, env=environment, input="said\n", capture_output=True, text=True)
    plain, forked = (subprocess.run([one, script, "7"], **run) for one in (sys.executable, warm.python()))
    assert (forked.returncode, forked.stdout, forked.stderr) == (7, plain.stdout, plain.stderr)
    assert plain.stdout.startswith("['7']") and plain.stderr == "said\n"
    broken = subprocess.run([warm.python(), script], **run)
    assert broken.returncode == 1 and "IndexError" in broken.stderr


def test_abandoned_process_is_ended(tmp_path):
    script, mark = tmp_path / "script.py", tmp_path / "mark"
    script.write_text(f"import os, time; open({str(mark)!r}, 'w').write(str(os.getpid())); time.sleep(300)")
    process = subprocess.Popen([warm.python(), script])
    while not mark.exists() or not mark.read_text():
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    with pytest.raises(ProcessLookupError):
        while True:
            os.kill(int(mark.read_text()), 0)
            time.sleep(0.02)
