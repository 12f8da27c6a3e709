"""One table of all recordings, written and printed."""

import json

from virtual_phantom.io import files
from virtual_phantom.recordings.summary import readable, summary_table
from virtual_phantom.study.job import job

with job(snakemake) as log:
    names, paths = snakemake.params.names, snakemake.input.summaries
    found = {name: json.loads(files.read_text(path)) for name, path in zip(names, paths, strict=True)}
    rows = summary_table(found)
    files.write_csv(rows, snakemake.output[0])
    print(readable(rows) or "The configuration names no recordings; docs/how-to/recordings.md says how.")
