"""Write the first page of the results: stable features, warnings, figures, tables and next steps."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.io import files
from virtual_phantom.report import index, study
from virtual_phantom.study.job import job, log


def main(
    *,
    figure_files: Sequence[str],
    caption_files: Sequence[str],
    table_files: Sequence[str],
    output: str,
    figure_titles: Sequence,
    table_titles: Sequence[str],
    reports: Sequence[str],
    commands: Sequence,
    other_pages: Mapping[str, str],
    pairs: Sequence[Mapping],
    impossible: Sequence[str],
    config: Mapping,
) -> None:
    target = Path(output)
    figures = study.report_figures(figure_files, caption_files, figure_titles)
    tables = list(zip(table_titles, map(Path, table_files), strict=True))
    diagnoses = [Path(path) for path in reports if Path(path).exists()]
    existing = {title: address for title, address in other_pages.items() if (target.parent / address).exists()}
    html = index.index_page(target.parent, figures, tables, diagnoses, config, commands, existing, pairs, impossible)
    files.write_text(html, target)
    log.info("%d figures, %d tables, %d diagnoses", len(figures), len(tables), len(diagnoses))


if "snakemake" in globals():
    with job(snakemake):
        main(
            figure_files=snakemake.input.figures,
            caption_files=snakemake.input.captions,
            table_files=snakemake.input.tables,
            output=snakemake.output[0],
            figure_titles=snakemake.params.figures,
            table_titles=snakemake.params.tables,
            reports=snakemake.params.diagnoses,
            commands=snakemake.params.commands,
            other_pages=snakemake.params.other_pages,
            pairs=snakemake.params.pairs,
            impossible=snakemake.params.impossible,
            config=snakemake.params.config,
        )
