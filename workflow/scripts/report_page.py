"""The report of the study as one page."""

from pathlib import Path

from virtual_phantom.io import files
from virtual_phantom.report import study
from virtual_phantom.study.job import job

with job(snakemake) as log:
    paths, params = snakemake.input, snakemake.params
    figures = study.report_figures(paths.figures, paths.captions, params.figures)
    tables = {title: Path(path) for title, path in zip(params.tables, paths.tables, strict=True)}
    embedded = {Path(path).parent.name: Path(path) for path in params.diagnoses}
    page = study.report_page(figures, tables, embedded, params.links, params.config)
    files.write_text(page, snakemake.output[0])
    log.info("%d figures, %d tables, %d diagnoses, %.1f MB", len(figures), len(tables), len(embedded), len(page) / 1e6)
