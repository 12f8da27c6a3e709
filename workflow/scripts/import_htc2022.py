"""Convert a downloaded sinogram of the Helsinki Tomography Challenge 2022 to a recording."""

from virtual_phantom.recordings.importers.htc2022 import import_htc2022
from virtual_phantom.study.job import job, log


def main(*, source: str, folder: str) -> None:
    recording = import_htc2022(source, folder)
    log.info("%s: %d views", recording.name, recording.geometry.views)


if "snakemake" in globals():
    with job(snakemake):
        main(source=snakemake.input[0], folder=snakemake.output[0])
