"""`snakemake --lint` and snakefmt find nothing except what CONTRIBUTING.md explains."""

import re
import subprocess
import sys
from pathlib import Path

from workflow_runs import ROOT, snakemake

# Rules run in Snakemake's own environment, because the Snakefile itself needs the library.
EXCEPTION = "Specify a conda environment or container for each rule."


def test_lint_only_suggests_environments():
    process = snakemake("--lint")
    found = re.findall(r"^    \* (.+):$", process.stdout + process.stderr, re.MULTILINE)
    assert set(found) == {EXCEPTION}, process.stderr[-4000:]
    assert len(found) > 40
    assert EXCEPTION.rstrip(".").lower() in " ".join((ROOT / "CONTRIBUTING.md").read_text().lower().split())


def test_rules_are_formatted():
    program = Path(sys.executable).with_name("snakefmt")
    command = [program, "--check", "Snakefile", "workflow"]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert process.returncode == 0, process.stderr[-2000:]
