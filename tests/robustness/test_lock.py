"""environment-pip.lock holds the hashes of the packages pinned in environment-pip.txt only."""

import re
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]


def pinned(text):
    """[(package, version)] of the lines of a requirements file, without options and comments."""
    lines = (re.split(r"\s(?:#|--|\\)|^#", line)[0].strip() for line in text.splitlines())
    required = [Requirement(line) for line in lines if line and not line.startswith("-")]
    return sorted((canonicalize_name(one.name), str(one.specifier)) for one in required)


def test_lock_names_the_same_versions():
    lock, pins = ((ROOT / f"environment-pip.{suffix}").read_text() for suffix in ("lock", "txt"))
    assert len(pinned(pins)) > 100
    assert pinned(lock) == pinned(pins), "run make lock"


def test_every_package_has_a_sha256_and_no_url():
    lock = (ROOT / "environment-pip.lock").read_text()
    packages = re.split(r"\n(?=\S)", re.sub(r"^#.*\n", "", lock, flags=re.MULTILINE))
    assert len(packages) > 100
    for package in packages:
        first, *hashes = package.strip().splitlines()
        assert re.fullmatch(r"[a-z0-9_-]+==[\w.]+ \\", first), first
        assert hashes, f"{first} has no hash"
        for line in hashes:
            assert re.fullmatch(r"    --hash=sha256:[0-9a-f]{64}(?: \\)?", line), line
