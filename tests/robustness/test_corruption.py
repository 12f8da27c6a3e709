"""A file that was spoiled after it was written is refused by name; none gives another number in silence."""

import os
import warnings

import numpy as np
import pytest
from artefacts import ARTEFACTS, mutations, same

from virtual_phantom.base.errors import InputError
from virtual_phantom.io import files

OURS_TO_READ = [one for one in ARTEFACTS if one.name != "YAML, physics"]  # Snakemake reads that one
MUTATIONS = int(os.environ.get("MUTATIONS", "40"))  # of each kind of file


@pytest.mark.parametrize("artefact", ARTEFACTS, ids=[one.name for one in ARTEFACTS])
def test_every_spoiled_file_is_refused_by_name(artefact, tmp_path):
    path = artefact.write(tmp_path)
    whole, random = path.read_bytes(), np.random.default_rng(0)
    assert same(artefact.read(path), artefact.read(path))
    for what, spoiled in mutations(whole, MUTATIONS, random):
        path.write_bytes(spoiled)
        if spoiled == whole:  # zeros over zeros
            continue
        with pytest.raises(InputError, match="is not as it was written") as error:
            artefact.read(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value), what


@pytest.mark.parametrize("artefact", OURS_TO_READ, ids=[one.name for one in OURS_TO_READ])
def test_a_file_without_its_checksum_is_taken_or_refused_in_a_line(artefact, tmp_path):
    """As a user's own files are: what structure does not tell cannot be known, but nothing may break otherwise."""
    path = artefact.write(tmp_path)
    whole, random = path.read_bytes(), np.random.default_rng(1)
    expected = artefact.read(path)
    files.checksum_path(path).unlink()
    assert same(artefact.read(path), expected)
    for what, spoiled in mutations(whole, MUTATIONS, random):
        path.write_bytes(spoiled)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of numbers that are wrong by intent
                found = artefact.read(path)
        except InputError as error:
            assert str(path.parent) in str(error) and "\n" not in str(error), (what, error)
        except Exception as error:
            pytest.fail(f"{what}: {type(error).__name__}: {error}")
        else:
            # Of these, checksums within the format tell of every change of a number.
            assert artefact.name != "NIfTI, compressed" or same(found, expected), what


def test_a_spoiled_checksum_is_refused(tmp_path):
    files.write_text("A: 1\n", tmp_path / "a.yaml")
    kept = files.checksum_path(tmp_path / "a.yaml")
    for content in (b"", kept.read_bytes()[:20], b"\xff" * 64):
        kept.write_bytes(content)
        with pytest.raises(InputError, match="a.yaml: is not as it was written"):
            files.read_text(tmp_path / "a.yaml")


def test_the_checksum_is_what_sha256sum_reads(tmp_path):
    files.write_text("A: 1\n", tmp_path / "a.yaml")
    digest, name = files.checksum_path(tmp_path / "a.yaml").read_text().split()
    assert name == "a.yaml" and digest == files.sha256(tmp_path / "a.yaml")


def test_a_failed_write_keeps_the_old_file_and_its_checksum(tmp_path):
    files.write_text("old", tmp_path / "a.txt")
    with pytest.raises(RuntimeError), files.replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("new")
        raise RuntimeError
    assert files.read_text(tmp_path / "a.txt") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".a.txt.sha256", "a.txt"]
