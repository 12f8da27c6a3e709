"""All feature tables in one."""

from virtual_phantom.features import tables
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake) as log:
    table = tables.merge_tables(tables.read_features(path) for path in snakemake.input.features)
    files.write_csv(table, snakemake.output[0])
    log.info("%d rows from %d images", len(table), len(snakemake.input.features))
