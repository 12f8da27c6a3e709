"""Overlap of the highest-ranked simulated and measured features."""

from virtual_phantom import files
from virtual_phantom.job import job
from virtual_phantom.statistics import ranking

with job(snakemake) as log:
    table = ranking.overlap(files.read_csv(snakemake.input.stability), files.read_csv(snakemake.input.scores))
    files.write_csv(table, snakemake.output[0])
    for kind in ranking.KINDS:
        above = (table[f"overlap_{kind}_percent"] > table["upper_percent"]).sum()
        log.info(
            "%s: area %.3f (unrelated lists %.3f), above the 95 %% band at %d of %d sizes",
            kind,
            table[f"area_{kind}"].iloc[0],
            table["area_expected"].iloc[0],
            above,
            len(table),
        )
