"""Page of the licenses of the packages in environment-pip.txt, from the metadata of the installed packages."""

from importlib.metadata import Distribution, distribution
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
INTRODUCTION = """# Licenses of the dependencies

From the metadata of the installed packages. Virtual Phantom itself has the [MIT license](../../LICENSE) and contains
none of these packages; `make setup` downloads them. The following licenses are not permissive:

* astra-toolbox (GPL 3): a program that is distributed together with it must be distributed under the GPL;
* certifi, hypothesis, pathspec and tqdm (MPL 2): changes of their own files must be published under the MPL;
* the NVIDIA libraries: proprietary, and used only with a CUDA device.

`make setup` does not install `environment-slurm.txt` (two plugins, MIT) and `environment-gpu.txt` (CuPy, MIT;
cuda-pathfinder, Apache 2.0; more NVIDIA libraries).

| package | version | license |
|---|---|---|
"""
LONGEST = 60  # characters; some packages put the full text of the license there


def pinned() -> dict[str, str]:
    """Return {package: version} of environment-pip.txt, in its order."""
    lines = (ROOT / "environment-pip.txt").read_text(encoding="utf-8").splitlines()
    return dict(line.split("#")[0].strip().split("==") for line in lines if "==" in line.split("#")[0])


def license_of(package: Distribution) -> str:
    """Return the license of a package.

    It is the first of: SPDX expression, license field of one line, classifiers, first line of the license field, first
    line of a license file. Raises ValueError if there is none of them.
    """
    metadata = package.metadata
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
    for file in package.files or []:
        if file.name.upper().startswith(("LICENSE", "LICENCE", "COPYING")):
            lines = file.read_text(encoding="utf-8").splitlines()
            return next(line.strip() for line in lines if line.strip())[:LONGEST]
    raise ValueError(f"{metadata['Name']}: its metadata give no license; add it by hand")


def page() -> str:
    """Return the page."""
    rows = [f"| {name} | {version} | {license_of(distribution(name))} |\n" for name, version in pinned().items()]
    return INTRODUCTION + "".join(rows)
