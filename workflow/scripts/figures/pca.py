"""Figure of one principal component analysis."""

from virtual_phantom.figures import pca, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(*, table: str, outputs: list[str], title: str, trial: bool) -> None:
    figure = pca.draw(files.read_csv(table), title)
    style.save(figure, outputs, trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table=snakemake.input.table,
            outputs=[snakemake.output.png, snakemake.output.pdf],
            title=snakemake.params.title,
            trial=snakemake.params.trial,
        )
