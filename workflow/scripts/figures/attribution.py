"""Figure of what each property of the images explains."""

from virtual_phantom.figures import attribution, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake):
    table, output = files.read_csv(snakemake.input.table), snakemake.output
    style.save(attribution.draw(table, snakemake.params.title), [output.png, output.pdf], trial=snakemake.params.trial)
