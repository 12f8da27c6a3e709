"""Write and print one table of all recordings."""

import json
from collections.abc import Sequence

from virtual_phantom.io import files
from virtual_phantom.recordings.summary import readable, summary_table
from virtual_phantom.study.job import job


def main(*, paths: Sequence[str], output: str, names: Sequence[str]) -> None:
    found = {name: json.loads(files.read_text(path)) for name, path in zip(names, paths, strict=True)}
    rows = summary_table(found)
    files.write_csv(rows, output)
    print(readable(rows) or "The configuration names no recordings; docs/how-to/recordings.md says how.")


if "snakemake" in globals():
    with job(snakemake):
        main(
            paths=snakemake.input.summaries,
            output=snakemake.output[0],
            names=snakemake.params.names,
        )
