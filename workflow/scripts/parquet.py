"""Write CSV tables as Parquet, with the same rows and columns and the type of each column."""

from collections.abc import Sequence

from virtual_phantom.io import files
from virtual_phantom.study.job import job, log


def main(*, table_files: Sequence[str], outputs: Sequence[str]) -> None:
    for source, target in zip(table_files, outputs, strict=True):
        table = files.read_csv(source)
        files.write_parquet(table, target)
        log.info("%s: %d rows, %d columns", target, *table.shape)


if "snakemake" in globals():
    with job(snakemake):
        main(table_files=snakemake.input.tables, outputs=snakemake.output)
