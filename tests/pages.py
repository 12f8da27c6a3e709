"""Pages of the documentation as tests run them: code blocks, and comments before them that say what they are.

<!-- write FILE -->   the block is the content of a file
<!-- run -->          the block is run by bash
<!-- run first -->    the block is run before all others: what stands at the end for readers without data of their own
<!-- prints -->       each line of the block stands, in this order, in what the last one run printed; ... is any text
<!-- makes -->        each line of the block is a file that is there

With "on slurm" at its end (<!-- run on slurm -->) a comment holds where there is a SLURM: tests/cluster/run.py does it.
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
    """The marked blocks in their order. Fails on a comment of this kind that no block follows."""
    text = page.read_text(encoding="utf-8")
    found = [Block(kind, file, bool(slurm), content) for kind, file, slurm, content in MARKED.findall(text)]
    comments = re.findall(r"^<!-- (?:write|run|prints|makes)\b.*-->", text, re.MULTILINE)
    assert found and len(found) == len(comments), f"{page}: {len(comments)} comments, {len(found)} blocks after them"
    return found


def follow(page: Path, folder: Path, slurm: bool = False) -> None:
    """Do in `folder` what the page says, and fail at the first thing that does not come out as it says.

    slurm   what needs a SLURM is done too, and left out otherwise
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
    """What the workflow and its pages need of the project, into a new folder."""
    folder.mkdir()
    for name in PARTS:
        if (root / name).is_dir():
            shutil.copytree(root / name, folder / name, ignore=BEING_WRITTEN)
        else:
            shutil.copy2(root / name, folder / name)


def run(commands: str, folder: Path) -> str:
    """What commands print in `folder`, a copy of the project, run by bash with this interpreter's programs and the
    copy's library, as if `make setup` had been run there. Fails where one of them does."""
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
