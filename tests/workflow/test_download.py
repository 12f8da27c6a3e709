"""Fetching published recordings: from a server of this machine, and one line where there is none."""

import functools
import http.server
import threading

import pytest
from workflow_runs import ROOT, tiny

SINOGRAMS = ROOT / "../shared/real/htc2022"


@pytest.fixture
def server():
    """Serves the real sinograms as Zenodo does."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(SINOGRAMS))
    with http.server.ThreadingHTTPServer(("localhost", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_address[1]}"
        server.shutdown()


@pytest.mark.real
@pytest.mark.skipif(not SINOGRAMS.exists(), reason="the real sinograms are not beside this checkout")
def test_a_sinogram_is_fetched_and_becomes_a_recording(server, tmp_path):
    folder = tmp_path / "r" / "downloads" / "htc2022_ta"
    process = tiny(tmp_path / "r", folder, overlay={"downloads": {"htc2022": server}})
    assert process.returncode == 0, process.stderr[-3000:]
    assert (folder / "recording.yaml").exists() and (folder / "projections.h5").exists()


def test_without_a_server_there_is_one_line(tmp_path):
    folder = tmp_path / "r" / "downloads" / "htc2022_ta"
    process = tiny(tmp_path / "r", folder, overlay={"downloads": {"htc2022": "http://localhost:9"}})
    errors = [line for line in (process.stdout + process.stderr).splitlines() if line.startswith("Error:")]
    assert process.returncode == 1 and "Traceback" not in process.stderr
    assert len(errors) == 1 and "htc2022_ta_full.mat cannot be fetched (no connection)" in errors[0]
