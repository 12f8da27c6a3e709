"""Running the workflow from tests."""

import os
import re
import subprocess
from pathlib import Path

import warm
import yaml

ROOT = Path(__file__).resolve().parents[2]
TINY = ROOT / "config" / "tiny.yaml"
# Shipped overlays on an overlay.
BENEATH = {
    "every_scan.yaml": ("printed_phantom.yaml",),
    "multicentre.yaml": ("printed_phantom.yaml",),
    "paper_subset.yaml": ("paper.yaml",),
    "printed_groups.yaml": ("printed_phantom.yaml",),
}


def snakemake(*arguments, cores=2, environment=None, timeout=900, project=ROOT):
    """Run snakemake in the repository, or a copy of it, with additional variables.

    Returns the finished process with output and errors as text. A dry run lists every file of each job.
    """
    in_full = ["-p"] if "-n" in arguments else []
    command = [warm.python(), "-m", "snakemake", "--cores", str(cores), "--nolock", *map(str, arguments), *in_full]
    environment = os.environ | (environment or {})
    return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, timeout=timeout)


def tiny(folder, *targets, cores=2, overlay=None, config_folder=None, **run):
    """Run the tiny study into `folder`; `overlay` is a dict of config keys on top of it, written to `config_folder`.

    run   further arguments of `snakemake`
    """
    files = [TINY]
    if overlay is not None:
        config_folder = config_folder or folder.parent
        config_folder.mkdir(parents=True, exist_ok=True)
        files.append(config_folder / "overlay.yaml")
        files[-1].write_text(yaml.safe_dump(overlay))
    # Targets come first: --config and --configfile would take them as values.
    settings = ("--configfile", *files, "--config", f"results_dir={folder}")
    return snakemake(*targets, *settings, cores=cores, **run)


def planned(process):
    """{rule: [wildcards]} of a dry run."""
    assert process.returncode == 0, process.stderr[-2000:]
    jobs: dict[str, list[str]] = {}
    for line in map(str.strip, process.stdout.splitlines()):  # rules of a group are indented
        if match := re.fullmatch(r"(?:local)?rule (\w+):", line):
            jobs.setdefault(match[1], [])
            last = match[1]
        elif line.startswith("wildcards: "):
            jobs[last].append(line.removeprefix("wildcards: "))
    return jobs
