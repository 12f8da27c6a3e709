"""Figure of one comparison with a recording: every feature and ROI."""

from virtual_phantom.figures import comparison, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(
    *,
    cells_file: str,
    features: str,
    png: str,
    pdf: str,
    title: str,
    trial: bool,
) -> None:
    cells, summary = files.read_csv(cells_file), files.read_csv(features)
    style.save(comparison.draw(cells, summary, title), [png, pdf], trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            cells_file=snakemake.input.cells,
            features=snakemake.input.features,
            png=snakemake.output.png,
            pdf=snakemake.output.pdf,
            title=snakemake.params.title,
            trial=snakemake.params.trial,
        )
