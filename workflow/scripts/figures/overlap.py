"""Figure of the overlap of the best features in simulation and measurement."""

from virtual_phantom.figures import overlap, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake):
    figure = overlap.draw(files.read_csv(snakemake.input.table))
    style.save(figure, [snakemake.output.png, snakemake.output.pdf], trial=snakemake.params.trial)
