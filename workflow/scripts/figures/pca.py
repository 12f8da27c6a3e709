"""Figure of one principal component analysis."""

from virtual_phantom.figures import pca, style, tables
from virtual_phantom.job import job

with job(snakemake):
    figure = pca.draw(tables.read_table(snakemake.input.table), snakemake.params.title)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
