"""Figure of the stability of each feature with and without the physics of the study."""

from collections.abc import Mapping

from virtual_phantom.figures import physics_change, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(*, table: str, outputs: list[str], threshold: float, noise: Mapping, trial: bool) -> None:
    figure = physics_change.draw(files.read_csv(table), threshold, noise=noise)
    style.save(figure, outputs, trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table=snakemake.input.table,
            outputs=[snakemake.output.png, snakemake.output.pdf],
            threshold=snakemake.params.threshold,
            noise=snakemake.params.noise,
            trial=snakemake.params.trial,
        )
