"""Commands in the documentation, as a user would type them."""

import re
from pathlib import Path

PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    "config/README.md",
    "workflow/**/*.md",
    "docs/**/*.md",
    "docs/generators/*.yaml",
)
NAMES = "snakemake|virtual-phantom-import|virtual-phantom|python|make|pytest|pip|ruff|snakefmt|git|mkdir|source"
PROGRAMS = rf"(?:{NAMES}|\S+/bin/\S+|EXAMPLES=\S+)"
FENCED = re.compile(r"^(<!-- run(?: first| on slurm)? -->\n+)?```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(rf"`({PROGRAMS} [^`]+)`")


def commands(root: Path) -> dict[str, list[str]]:
    """Every command and the pages that name it.

    Blocks that are marked to be run are excluded: tests/workflow/test_marked_pages.py runs them, and
    tests/cluster/run.py those that need SLURM.
    """
    found: dict[str, list[str]] = {}
    for page in sorted({path for pattern in PAGES for path in root.glob(pattern)}):
        text = page.read_text(encoding="utf-8")
        lines = [
            line
            for run, language, block in FENCED.findall(text)
            if not run and language in ("", "bash", "sh")
            for line in block.replace("\\\n", " ").splitlines()
            if re.match(PROGRAMS + r"(\s|$)", line)
        ]
        lines += [one.replace("\n", " ") for one in INLINE.findall(FENCED.sub("", text))]
        for line in lines:
            command = " ".join(re.sub(r"\s#.*", "", line).split())
            pages = found.setdefault(command, [])
            if (name := str(page.relative_to(root))) not in pages:
                pages.append(name)
    return found
