"""Fetching published measurements from a local server, and one line without a server."""

import contextlib
import functools
import http.server
import os
import threading

import pytest
import yaml
from published_files import TABLE, copy_with_bytes, put
from workflow_runs import ROOT, snakemake, tiny

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.io.files import sha256
from virtual_phantom.io.published import read_published

SINOGRAMS = ROOT / "../shared/real/htc2022"
ABDOMEN_CT = ROOT / "../shared/real/abdomen_ct"
NOWHERE = "http://localhost:9"


@contextlib.contextmanager
def served(folder):
    """Serve a folder like a web server."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("localhost", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_address[1]}"
        server.shutdown()


@pytest.mark.real
@pytest.mark.skipif(not SINOGRAMS.exists(), reason="the real sinograms are not beside this checkout")
def test_sinogram_is_fetched_and_becomes_a_recording(tmp_path):
    folder = tmp_path / "r" / "downloads" / "htc2022_ta"
    with served(SINOGRAMS) as server:
        process = tiny(tmp_path / "r", folder, overlay={"downloads": {"htc2022": server}})
    assert process.returncode == 0, process.stderr[-3000:]
    assert (folder / "recording.yaml").exists() and (folder / "projections.h5").exists()


def test_without_a_server_there_is_one_line(tmp_path):
    folder = tmp_path / "r" / "downloads" / "htc2022_ta"
    process = tiny(tmp_path / "r", folder, overlay={"downloads": {"htc2022": NOWHERE}})
    errors = [line for line in (process.stdout + process.stderr).splitlines() if line.startswith("Error:")]
    assert process.returncode == 1 and "Traceback" not in process.stderr
    assert len(errors) == 1 and "htc2022_ta_full.mat cannot be fetched (no connection)" in errors[0]


@pytest.mark.real
@pytest.mark.skipif(not ABDOMEN_CT.exists(), reason="the real CT is not beside this checkout")
def test_files_of_the_clinical_ct_are_those_of_the_list():
    files = read_published(RESOURCES / "abdomen_ct.csv")
    assert len(files) == 21
    for file in files:
        assert sha256(ABDOMEN_CT / file.path.removeprefix("resources/abdomen_ct/")) == file.sha256, file.path


def phantom(project, server, *arguments):
    """Run `snakemake` for the clinical CT's phantom; returns its output and errors."""
    (project / "mirror.yaml").write_text(yaml.safe_dump({"downloads": {"abdomen_ct": server}}))
    settings = ("--configfile", "config/abdomen.yaml", "mirror.yaml")
    process = snakemake(*arguments, *settings, project=project)
    output = process.stdout + process.stderr
    assert "Traceback" not in output, output[-3000:]
    return process.returncode, output, [line for line in output.splitlines() if line.startswith("Error:")]


def test_missing_clinical_ct_is_fetched(tmp_path):
    project, web = tmp_path / "project", tmp_path / "web"
    published, places = copy_with_bytes(project)
    first, *others = places
    image = "results-abdomen/phantom/image.nii.gz"
    code, _, errors = phantom(project, NOWHERE, "-n", image)
    assert code == 1 and len(errors) == 1
    assert "cannot be fetched (no connection)" in errors[0] and "resources/abdomen_ct/labels.nii.gz" in errors[0]

    put(web, published | {places[others[-1]]: b"another version of it"})
    with served(web) as server:
        code, _, errors = phantom(project, server, others[-1])
        assert code == 1 and len(errors) == 1 and f"is not the file that {TABLE} lists" in errors[0]
        assert not [path for path in places if (project / path).exists()]

        put(web, published)
        put(project, {first: published[places[first]]})
        os.utime(project / first, (1e9, 1e9))
        code, output, _ = phantom(project, server, "download_abdomen_ct")
        assert code == 0, output[-3000:]
    assert (project / first).stat().st_mtime == 1e9  # used unchanged
    assert {path: (project / path).read_bytes() for path in places} == {
        path: published[source] for path, source in places.items()
    }

    code, output, _ = phantom(project, NOWHERE, "-n", image)  # no second download
    assert code == 0 and "rule phantom:" in output and "download_abdomen_ct" not in output, output[-3000:]
    (project / others[-1]).write_bytes(b"drawn by somebody else")
    code, _, errors = phantom(project, NOWHERE, "-n", image)
    assert code == 1 and len(errors) == 1 and errors[0].startswith(f"Error: {others[-1]}: is not the file that")
