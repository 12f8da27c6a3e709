"""Figure of one comparison with a recording: every feature and ROI."""

from virtual_phantom.figures import comparison, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(*, cells_file: str, features: str, outputs: list[str], title: str, trial: bool) -> None:
    cells, summary = files.read_csv(cells_file), files.read_csv(features)
    style.save(comparison.draw(cells, summary, title), outputs, trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            cells_file=snakemake.input.cells,
            features=snakemake.input.features,
            outputs=[snakemake.output.png, snakemake.output.pdf],
            title=snakemake.params.title,
            trial=snakemake.params.trial,
        )
