"""Features of public scans in one table, and what makes a recording of it, for each way of extraction."""

import pandas as pd
import yaml

from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import EXTRACTED, recording_content
from virtual_phantom.study.job import job

with job(snakemake) as log:
    for way in EXTRACTED:
        table = pd.concat([files.read_csv(path) for path in snakemake.input[f"tables{way}"]], ignore_index=True)
        files.write_csv(table, snakemake.output[f"features{way}"])
        document = yaml.safe_dump(recording_content(snakemake.params.scans, way), sort_keys=False)
        files.write_text(document, snakemake.output[f"document{way}"])
    log.info("%d rows of %d scans", len(table), table["image"].nunique())
