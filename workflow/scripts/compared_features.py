"""Join the features of all public scans into a table, and write its recording.yaml.

A table with recording.yaml can be used as a recording. There is one table of 3D and one of 2D features.
"""

from collections.abc import Mapping, Sequence

import pandas as pd
import yaml

from virtual_phantom.io import files
from virtual_phantom.recordings.public_scans.features import EXTRACTION_MODES, recording_content
from virtual_phantom.recordings.public_scans.table import PublicScan
from virtual_phantom.study.job import job, log


def main(
    *,
    feature_files: Mapping[str, Sequence[str]],
    outputs: Mapping[str, str],
    recording_files: Mapping[str, str],
    scans: Sequence[PublicScan],
) -> None:
    for mode in EXTRACTION_MODES:
        table = pd.concat([files.read_csv(path) for path in feature_files[mode]], ignore_index=True)
        files.write_csv(table, outputs[mode])
        document = yaml.safe_dump(recording_content(scans, mode), sort_keys=False)
        files.write_text(document, recording_files[mode])
        log.info("%s: %d rows of %d scans", outputs[mode], len(table), table["image"].nunique())


if "snakemake" in globals():
    with job(snakemake):
        main(
            feature_files={mode: snakemake.input[f"tables{mode}"] for mode in EXTRACTION_MODES},
            outputs={mode: snakemake.output[f"features{mode}"] for mode in EXTRACTION_MODES},
            recording_files={mode: snakemake.output[f"document{mode}"] for mode in EXTRACTION_MODES},
            scans=snakemake.params.scans,
        )
