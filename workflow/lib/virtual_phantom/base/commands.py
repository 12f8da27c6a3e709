"""Shell commands for messages, with quotes and the Snakefile that they need."""

from __future__ import annotations

import importlib.util
import shlex
from pathlib import Path

from .data import clone

# Snakefiles that Snakemake looks for in the current folder, in this order.
SNAKEFILES = ("Snakefile", "snakefile", "workflow/Snakefile", "workflow/snakefile")
NO_CLONE = "CLONE"  # placeholder for the unknown path of the clone


def command_line(*words: object) -> str:
    """Return words as a command line, quoted for a shell."""
    return shlex.join(map(str, words))


def snakemake(*words: object, snakefile: Path | None = None) -> str:
    """Return a Snakemake command that works in the current folder.

    If the current folder has no Snakefile, the option `-s` names `snakefile`, or by default the Snakefile of the clone
    that contains the library. Without a clone, its path begins with NO_CLONE.
    """
    if any(Path(name).is_file() for name in SNAKEFILES):
        return command_line("snakemake", *words)
    if snakefile is None:
        snakefile = (clone() or Path(NO_CLONE)) / "workflow" / "Snakefile"
    return command_line("snakemake", "-s", snakefile, *words)


def missing_for_snakemake() -> str | None:
    """Return one line on what `snakemake` commands need that is not installed; None if nothing is missing."""
    if clone() is None and not any(Path(name).is_file() for name in SNAKEFILES):
        return (
            "The installed package has no workflow: clone the repository, run `make setup` in the clone, and put its "
            f"path in place of {NO_CLONE}"
        )
    if importlib.util.find_spec("snakemake") is None:
        return f"Snakemake is not installed here: run `make setup` in {clone() or 'the clone'} and activate its .venv"
    return None
