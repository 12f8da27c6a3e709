"""Write the report of the study as one page."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.io import files
from virtual_phantom.report import study
from virtual_phantom.study.job import job, log


def main(
    *,
    figure_files: Sequence[str],
    caption_files: Sequence[str],
    table_files: Sequence[str],
    output: str,
    figure_titles: Sequence,
    table_titles: Sequence[str],
    diagnoses: Sequence[str],
    links: Mapping,
    config: Mapping,
) -> None:
    figures = study.report_figures(figure_files, caption_files, figure_titles)
    tables = {title: Path(path) for title, path in zip(table_titles, table_files, strict=True)}
    embedded = {Path(path).parent.name: Path(path) for path in diagnoses}
    report_page = study.report_page(figures, tables, embedded, links, config)
    files.write_text(report_page, output)
    log.info(
        "%d figures, %d tables, %d diagnoses, %.1f MB", len(figures), len(tables), len(embedded), len(report_page) / 1e6
    )


if "snakemake" in globals():
    with job(snakemake):
        main(
            figure_files=snakemake.input.figures,
            caption_files=snakemake.input.captions,
            table_files=snakemake.input.tables,
            output=snakemake.output[0],
            figure_titles=snakemake.params.figures,
            table_titles=snakemake.params.tables,
            diagnoses=snakemake.params.diagnoses,
            links=snakemake.params.links,
            config=snakemake.params.config,
        )
