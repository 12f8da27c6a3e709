"""All feature tables in one."""

from virtual_phantom import feature_table, files
from virtual_phantom.job import job

with job(snakemake) as log:
    table = feature_table.merge(feature_table.read(path) for path in snakemake.input.features)
    files.write_csv(table, snakemake.output[0])
    log.info("%d rows from %d images", len(table), len(snakemake.input.features))
