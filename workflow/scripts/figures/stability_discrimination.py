"""Figure of stability against discriminative power, with the measured scores beside it where they apply."""

from virtual_phantom import files, measured
from virtual_phantom.figures import stability_discrimination, style
from virtual_phantom.job import job

with job(snakemake):
    params = snakemake.params
    scores = measured.load_scores() if params.with_measured else None
    table = files.read_csv(snakemake.input.table)
    figure = stability_discrimination.draw(table, params.threshold, scores)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
