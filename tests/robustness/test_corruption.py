"""Damaged files are rejected by name; none gives wrong numbers silently."""

import os
import resource
import signal
import warnings

import numpy as np
import pytest
from artefacts import ARTEFACTS, mutations, same

from virtual_phantom.base.errors import InputError
from virtual_phantom.io import files

OURS_TO_READ = [artefact for artefact in ARTEFACTS if artefact.name != "YAML, physics"]  # read by Snakemake
MADE_BY_JOBS = [artefact for artefact in ARTEFACTS if artefact.name != "YAML, recording"]  # the tests write that one
MUTATIONS = int(os.environ.get("MUTATIONS", "40"))  # per kind of file


@pytest.mark.parametrize("artefact", ARTEFACTS, ids=[artefact.name for artefact in ARTEFACTS])
def test_every_damaged_file_is_rejected_by_name(artefact, tmp_path):
    path = artefact.write(tmp_path)
    whole, random = path.read_bytes(), np.random.default_rng(0)
    assert same(artefact.read(path), artefact.read(path))
    for what, damaged in mutations(whole, MUTATIONS, random):
        path.write_bytes(damaged)
        if damaged == whole:  # zeros overwritten by zeros
            continue
        with pytest.raises(InputError, match="is not as it was written") as error:
            artefact.read(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value), what


@pytest.mark.parametrize("artefact", OURS_TO_READ, ids=[one.name for one in OURS_TO_READ])
def test_file_without_its_checksum_is_read_or_rejected_in_a_line(artefact, tmp_path):
    """As user files: damage that keeps the structure cannot be detected, but no other error is allowed."""
    path = artefact.write(tmp_path)
    whole, random = path.read_bytes(), np.random.default_rng(1)
    expected = artefact.read(path)
    files.checksum_path(path).unlink()
    assert same(artefact.read(path), expected)
    for what, damaged in mutations(whole, MUTATIONS, random):
        path.write_bytes(damaged)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # warnings about numbers that are wrong on purpose
                found = artefact.read(path)
        except InputError as error:
            assert str(path.parent) in str(error) and "\n" not in str(error), (what, error)
        except Exception as error:
            pytest.fail(f"{what}: {type(error).__name__}: {error}")
        else:
            # Formats with internal checksums, which detect every change of a number.
            assert artefact.name != "NIfTI, compressed" or same(found, expected), what


def test_damaged_checksum_is_rejected(tmp_path):
    files.write_text("A: 1\n", tmp_path / "a.yaml")
    stored = files.checksum_path(tmp_path / "a.yaml")
    for content in (b"", stored.read_bytes()[:20], b"\xff" * 64):
        stored.write_bytes(content)
        with pytest.raises(InputError, match="a.yaml: is not as it was written"):
            files.read_text(tmp_path / "a.yaml")


def test_checksum_is_readable_by_sha256sum(tmp_path):
    files.write_text("A: 1\n", tmp_path / "a.yaml")
    digest, name = files.checksum_path(tmp_path / "a.yaml").read_text().split()
    assert name == "a.yaml" and digest == files.sha256(tmp_path / "a.yaml")


def test_failed_write_keeps_the_old_file_and_its_checksum(tmp_path):
    files.write_text("old", tmp_path / "a.txt")
    with pytest.raises(RuntimeError), files.replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("new")
        raise RuntimeError
    assert files.read_text(tmp_path / "a.txt") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".a.txt.sha256", "a.txt"]


@pytest.mark.parametrize("artefact", MADE_BY_JOBS, ids=[artefact.name for artefact in MADE_BY_JOBS])
def test_job_that_is_killed_while_it_writes_leaves_no_half_file(artefact, tmp_path):
    """As on a node that fails: the process is killed after half of the file; the next job writes all of it."""
    first, again = tmp_path / "first", tmp_path / "again"
    first.mkdir()
    again.mkdir()
    whole = artefact.write(first)
    process = os.fork()
    if not process:
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        half = whole.stat().st_size // 2
        resource.setrlimit(resource.RLIMIT_FSIZE, (half, half))
        artefact.write(again)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == -signal.SIGXFSZ
    assert not (again / whole.relative_to(first)).exists()
    assert same(artefact.read(artefact.write(again)), artefact.read(whole))
