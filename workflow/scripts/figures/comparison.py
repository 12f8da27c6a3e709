"""Figure of one comparison with a recording: every feature and ROI."""

from virtual_phantom.figures import comparison, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake):
    cells, summary = files.read_csv(snakemake.input.cells), files.read_csv(snakemake.input.features)
    output, title = snakemake.output, snakemake.params.title
    style.save(comparison.draw(cells, summary, title), [output.png, output.pdf], trial=snakemake.params.trial)
