"""Merge all feature tables into one."""

from collections.abc import Sequence

from virtual_phantom.features import tables
from virtual_phantom.io import files
from virtual_phantom.study.job import job, log


def main(*, features: Sequence[str], output: str) -> None:
    table = tables.merge_tables(tables.read_features(path) for path in features)
    files.write_csv(table, output)
    log.info("%d rows from %d images", len(table), len(features))


if "snakemake" in globals():
    with job(snakemake):
        main(features=snakemake.input.features, output=snakemake.output[0])
