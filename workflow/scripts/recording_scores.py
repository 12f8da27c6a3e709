"""Stability and discriminative power of the features of a recording, over its conditions."""

from virtual_phantom import files
from virtual_phantom.errors import InputError
from virtual_phantom.job import job
from virtual_phantom.recordings.reading import load
from virtual_phantom.recordings.reference import scores

with job(snakemake) as log:
    recording = load(snakemake.params.folder)
    if recording.kind != "features":
        raise InputError(
            f"recording {snakemake.wildcards.recording}: holds {recording.kind}; analyses.stability.recordings takes "
            "recordings of features only"
        )
    table = scores(recording, **snakemake.params.statistics)
    files.write_csv(table, snakemake.output[0])
    log.info(
        "mean stability %.1f %%, mean discriminative power %.1f %%",
        table["stability_percent"].mean(),
        table["discrimination_percent"].mean(),
    )
