"""The page to start with: the answer, warnings, figures, tables, and what to do next."""

from pathlib import Path

from virtual_phantom.io import files
from virtual_phantom.report import index, study
from virtual_phantom.study.job import job

with job(snakemake) as log:
    paths, params, target = snakemake.input, snakemake.params, Path(snakemake.output[0])
    figures = study.report_figures(paths.figures, paths.captions, params.figures)
    tables = [index.LinkedTable(title, Path(path)) for title, path in zip(params.tables, paths.tables, strict=True)]
    diagnoses = [Path(path) for path in params.diagnoses if Path(path).exists()]
    beside = {title: page for title, page in params.beside.items() if (target.parent / page).exists()}
    page = index.index_page(target.parent, figures, tables, diagnoses, params.config, params.commands, beside)
    files.write_text(page, target)
    log.info("%d figures, %d tables, %d diagnoses", len(figures), len(tables), len(diagnoses))
