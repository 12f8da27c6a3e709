"""Write docs/licences.md: the licence of everything in environment-pip.txt, as its own metadata state it.

Run it in the environment of `make setup` after a dependency has changed: python docs/licences.py
"""

from __future__ import annotations

from importlib.metadata import Distribution, distribution
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TARGET = ROOT / "docs" / "licences.md"
INTRODUCTION = """# Licences of the dependencies

Written by `python docs/licences.py` from the metadata of the installed packages. Virtual Phantom itself is under the
[MIT licence](../LICENSE). None of these packages is part of it; `make setup` fetches them.

Not permissive are

* astra-toolbox (GPL 3): a program that is distributed together with it must be distributed under the GPL;
* certifi, hypothesis, pathspec and tqdm (MPL 2), which binds changes of their own files;
* NVIDIA's libraries, which are proprietary, and used only where there is a CUDA device.

The table leaves out what is not installed by default: `environment-slurm.txt` brings two plugins (MIT),
`environment-gpu.txt` CuPy (MIT), cuda-pathfinder (Apache 2.0) and more of NVIDIA's libraries.

| package | version | licence |
|---|---|---|
"""
LONGEST = 60  # characters; some packages have the whole text of the license in the field


def pinned() -> dict[str, str]:
    """Return {package: version} of environment-pip.txt, in its order."""
    lines = (line.split("#")[0].strip() for line in (ROOT / "environment-pip.txt").read_text().splitlines())
    return dict(line.split("==") for line in lines if "==" in line)


def licence(package: Distribution) -> str:
    """Return the license by SPDX expression, short license field, classifiers, or first line of the field or file."""
    metadata = package.metadata
    field = (metadata.get("License") or "").strip()
    classifiers = [entry.split(" :: ")[-1] for entry in metadata.get_all("Classifier") or [] if "License ::" in entry]
    files = [file for file in package.files or [] if file.name.upper().startswith(("LICENSE", "LICENCE", "COPYING"))]
    return (
        metadata.get("License-Expression")
        or ("\n" not in field and len(field) <= LONGEST and field)
        or ", ".join(word for word in classifiers if word != "OSI Approved")
        or (field or files[0].read_text(encoding="utf-8").strip()).splitlines()[0].strip()[:LONGEST]
    )


def page() -> str:
    """Return the whole page."""
    rows = [f"| {name} | {version} | {licence(distribution(name))} |" for name, version in pinned().items()]
    return INTRODUCTION + "\n".join(rows) + "\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
