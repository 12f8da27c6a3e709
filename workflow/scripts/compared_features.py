"""Features of public scans in one table, and what makes a recording of it."""

import pandas as pd
import yaml

from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import content
from virtual_phantom.study.job import job

with job(snakemake) as log:
    table = pd.concat([files.read_csv(path) for path in snakemake.input.tables], ignore_index=True)
    files.write_csv(table, snakemake.output.features)
    files.write_text(yaml.safe_dump(content(snakemake.params.scans), sort_keys=False), snakemake.output.document)
    log.info("%d rows of %d scans", len(table), table["image"].nunique())
