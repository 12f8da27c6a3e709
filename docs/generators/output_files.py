"""Page of the files that the workflow writes, from the table of outputs."""

from virtual_phantom.config.outputs import OUTPUTS

INTRODUCTION = """# Output files

All files that the workflow writes, relative to `results_dir`. A name in braces is a wildcard, such as a protocol, a
noise level or a recording. The last column names the Snakemake rule. Each job writes a log in `logs`. Checksums of data
files are in hidden files in the same folder ([stability](stability.md)). File formats: [outputs](../how-to/outputs.md).

| file | content | rule |
|---|---|---|
"""


def page() -> str:
    """Return the page."""
    rows = []
    for output in OUTPUTS:
        path = output.pattern + (".png, .pdf" if len(output.suffixes) > 1 else "")
        rows.append(f"| `{path}` | {output.description} | `{output.rule}` |\n")
    return INTRODUCTION + "".join(rows)
