"""Tables as Parquet beside their CSV: the same rows and columns, each with its type."""

from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake) as log:
    for source, target in zip(snakemake.input.tables, snakemake.output, strict=True):
        table = files.read_csv(source)
        files.write_parquet(table, target)
        log.info("%s: %d rows, %d columns", target, *table.shape)
