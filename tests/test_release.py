"""Consistency of a release: the version, and the container's environment."""

import re
import tomllib
from pathlib import Path

import yaml

import virtual_phantom
from virtual_phantom.report.methods import REFERENCE

ROOT = Path(__file__).resolve().parents[1]


def test_version_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    heading = re.search(r"^## (\S+) \((.+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert citation["version"] == heading[1] == virtual_phantom.__version__
    released = re.fullmatch(r"\d{4}-\d\d-\d\d", heading[2])
    assert released or heading[2] == "not released"
    assert ("date-released" in citation) == bool(released)


def test_software_and_paper_are_cited():
    """A `preferred-citation` would replace the citation of the software itself."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["type"] == "software" and citation["abstract"] and "preferred-citation" not in citation
    paper = next(entry for entry in citation["references"] if entry["type"] == "article")
    assert paper["doi"] in REFERENCE and {"data", "software"} <= {entry["type"] for entry in citation["references"]}


def test_container_installs_from_the_lock_with_the_same_command():
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    instructions = re.findall(r"^([A-Z]+) (.+)$", lines.replace("\\\n", ""), re.MULTILINE)
    assert ("RUN", "make setup") in instructions and not re.search(r"pip install|curl|wget", lines)
    # Debian 12 has the oldest supported Python.
    assert ("FROM", "debian:bookworm-slim") in instructions
    expected = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["requires-python"]
    assert expected.startswith(">=3.11")


def test_container_contains_no_results_and_no_environment():
    left_out = set((ROOT / ".dockerignore").read_text(encoding="utf-8").split())
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text(encoding="utf-8").split()}
    assert {".venv", ".snakemake", "results*", "recordings", "resources/*", "downloads"} <= left_out & ignored
