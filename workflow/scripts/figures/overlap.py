"""Figure of the overlap of the best features in simulation and measurement."""

from virtual_phantom.figures import overlap, style, tables
from virtual_phantom.job import job

with job(snakemake):
    figure = overlap.draw(tables.read_table(snakemake.input.table))
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
