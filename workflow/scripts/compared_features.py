"""Features of public scans in one table, and what makes a recording of it, for each way of extraction."""

from collections.abc import Mapping, Sequence

import pandas as pd
import yaml

from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import EXTRACTED, recording_content
from virtual_phantom.recordings.public_scans.table import PublicScan
from virtual_phantom.study.job import job, log


def main(
    *,
    feature_files: Mapping[str, Sequence[str]],
    outputs: Mapping[str, str],
    documents: Mapping[str, str],
    scans: Sequence[PublicScan],
) -> None:
    for way in EXTRACTED:
        table = pd.concat([files.read_csv(path) for path in feature_files[way]], ignore_index=True)
        files.write_csv(table, outputs[way])
        document = yaml.safe_dump(recording_content(scans, way), sort_keys=False)
        files.write_text(document, documents[way])
    log.info("%d rows of %d scans", len(table), table["image"].nunique())


if "snakemake" in globals():
    with job(snakemake):
        main(
            feature_files={way: snakemake.input[f"tables{way}"] for way in EXTRACTED},
            outputs={way: snakemake.output[f"features{way}"] for way in EXTRACTED},
            documents={way: snakemake.output[f"document{way}"] for way in EXTRACTED},
            scans=snakemake.params.scans,
        )
