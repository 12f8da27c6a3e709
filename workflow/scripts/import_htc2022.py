"""A downloaded sinogram of the Helsinki Tomography Challenge 2022 as a recording."""

from virtual_phantom.recordings.importers.htc2022 import import_htc2022
from virtual_phantom.study.job import job

with job(snakemake) as log:
    recording = import_htc2022(snakemake.input[0], snakemake.output[0])
    log.info("%s: %d views", recording.name, recording.geometry.views)
