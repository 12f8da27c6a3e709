"""docs/licences.md lists the licence of every pinned package, as its metadata state it."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def licences():
    spec = importlib.util.spec_from_file_location("licences", ROOT / "docs" / "licences.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date(licences):
    assert licences.page() == (ROOT / "docs" / "licences.md").read_text(), "run python docs/licences.py"


def test_every_package_is_pinned_to_the_version_that_is_installed(licences):
    pinned = licences.pinned()
    assert len(pinned) > 100
    for name, version in pinned.items():
        assert licences.distribution(name).version == version, f"{name}: run make setup"
