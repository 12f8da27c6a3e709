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
LONGEST = 60  # characters; some packages put the licence's whole text there


def pinned() -> dict[str, str]:
    """{package: version} of environment-pip.txt, in its order."""
    lines = (ROOT / "environment-pip.txt").read_text(encoding="utf-8").splitlines()
    return dict(line.split("#")[0].strip().split("==") for line in lines if "==" in line.split("#")[0])


def licence(found: Distribution) -> str:
    """By, in this order: SPDX expression, a licence field of one line, classifiers, the field's title, a file's title.

    Raises ValueError if none of them says.
    """
    metadata = found.metadata
    if expression := metadata.get("License-Expression"):
        return expression
    field = (metadata.get("License") or "").strip()
    if field and "\n" not in field and len(field) <= LONGEST:
        return field
    classifiers = [one for one in metadata.get_all("Classifier") or [] if one.startswith("License ::")]
    if words := [one.split(" :: ")[-1] for one in classifiers if not one.endswith("OSI Approved")]:
        return ", ".join(words)
    if field:
        return field.splitlines()[0].strip()[:LONGEST]
    for file in found.files or []:
        if file.name.upper().startswith(("LICENSE", "LICENCE", "COPYING")):
            lines = file.read_text(encoding="utf-8").splitlines()
            return next(line.strip() for line in lines if line.strip())[:LONGEST]
    raise ValueError(f"{metadata['Name']}: says nothing of its licence; look it up")


def page() -> str:
    """The whole page."""
    rows = [f"| {name} | {version} | {licence(distribution(name))} |" for name, version in pinned().items()]
    return INTRODUCTION + "\n".join(rows) + "\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
