"""Follow the marked code blocks of documentation pages. A comment before a block says what to do with it.

<!-- write FILE -->   Write the block to a file.

<!-- run -->          Run the block with bash.

<!-- run first -->    Run the block before all others: it makes example data for readers without data.

<!-- prints -->       The last run printed each line of the block, in this order. ... is any text.

<!-- makes -->        Each line of the block is an existing file.

With "on slurm" at its end (<!-- run on slurm -->), a comment applies where SLURM is installed (tests/cluster/run.py).
"""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import warm

MARKED = re.compile(
    r"^<!-- (write|run first|run|prints|makes)(?: (?!on )(\S+))?( on slurm)? -->\n+```\w*\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
COMMENT = r"^<!-- (?:write|run|prints|makes)\b.*-->"
TIMEOUT_S = 900
PARTS = ("Snakefile", "config", "docs", "profiles", "pyproject.toml", "tests", "workflow")
BEING_WRITTEN = shutil.ignore_patterns("*.tmp.*", "*.pyc.*")  # by other tests; compiled kernels come along


@dataclass(frozen=True)
class Block:
    """One marked block of a page."""

    kind: str
    file: str
    on_slurm: bool
    text: str


def blocks(page: Path) -> list[Block]:
    """Return the marked blocks in their order. Fail if a comment is not followed by a block."""
    text = page.read_text(encoding="utf-8")
    found = [Block(kind, file, bool(slurm), content) for kind, file, slurm, content in MARKED.findall(text)]
    comments = re.findall(COMMENT, text, re.MULTILINE)
    assert found and len(found) == len(comments), f"{page}: {len(comments)} comments, {len(found)} blocks after them"
    return found


def marked(folder: Path) -> list[Path]:
    """Return the pages in a folder that have marked blocks."""
    pages = sorted(folder.rglob("*.md"))
    return [page for page in pages if re.search(COMMENT, page.read_text(encoding="utf-8"), re.MULTILINE)]


def follow(page: Path, folder: Path, slurm: bool = False) -> None:
    """Follow a page in `folder`. Fail at the first block that does not give the stated result.

    With `slurm`, include the blocks that need SLURM.
    """
    printed = None
    for block in sorted(blocks(page), key=lambda block: block.kind != "run first"):
        if block.on_slurm and not slurm:
            continue
        if block.kind == "write":
            path = folder / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.kind == "run first":
            run(block.text, folder)
        elif block.kind == "run":
            printed = run(block.text, folder)
        elif block.kind == "prints":
            assert printed is not None, f"{page}: nothing has been run before {block.text!r}"
            _check_printed(block.text, printed)
        else:
            for name in block.text.split():
                assert (folder / name).is_file() and (folder / name).stat().st_size > 0, f"{page}: {name} is not there"


def copy_project(root: Path, folder: Path) -> None:
    """Copy the parts of the project that the workflow and its pages need to a new folder."""
    folder.mkdir()
    for name in PARTS:
        if (root / name).is_dir():
            shutil.copytree(root / name, folder / name, ignore=BEING_WRITTEN)
        else:
            shutil.copy2(root / name, folder / name)


def share_kernels(root: Path, folder: Path) -> None:
    """Let a copy of the project use the folder of compiled kernels of the project, whose names are hashes of code."""
    project, copy = (path / "workflow" / "lib" / "virtual_phantom" / "__pycache__" for path in (root, folder))
    for path in (project / "kernels", copy):
        path.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(copy / "kernels", ignore_errors=True)
    (copy / "kernels").symlink_to(project / "kernels")


def run(commands: str, folder: Path) -> str:
    """Run commands with bash in `folder`, a copy of the project, and return their output. Fail if a command fails.

    The commands use the programs of this environment and the library of the copy, as after `make setup`.
    """
    programs = os.pathsep.join([str(warm.programs()), str(Path(sys.executable).parent), os.environ["PATH"]])
    process = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", commands],
        cwd=folder,
        env={**os.environ, "PATH": programs, "PYTHONPATH": str(folder / "workflow" / "lib")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT_S,
    )
    assert process.returncode == 0, f"{commands}\n{process.stdout[-4000:]}"
    return process.stdout


def _check_printed(expected, printed):
    words = " ".join(printed.split())
    place = 0
    for line in filter(None, (" ".join(line.split()) for line in expected.splitlines())):
        pattern = ".*?".join(map(re.escape, line.split("...")))
        match = re.compile(pattern).search(words, place)
        assert match, f"{line!r} is not in, or not at its place:\n{printed[-4000:]}"
        place = match.end()
