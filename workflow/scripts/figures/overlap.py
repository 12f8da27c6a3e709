"""Figure of the overlap of the best features in simulation and measurement."""

from virtual_phantom.figures import overlap, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(*, table: str, outputs: list[str], trial: bool) -> None:
    figure = overlap.draw(files.read_csv(table))
    style.save(figure, outputs, trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table=snakemake.input.table,
            outputs=[snakemake.output.png, snakemake.output.pdf],
            trial=snakemake.params.trial,
        )
