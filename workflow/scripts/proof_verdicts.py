"""Bind every diagnosis by its hash, before any seal is opened."""

from pathlib import Path

from virtual_phantom.job import job
from virtual_phantom.proof import seal

with job(snakemake) as log:
    for diagnosis, path in zip(snakemake.input.diagnoses, snakemake.output, strict=True):
        seal.write(seal.verdict_of(Path(path).stem, diagnosis), path)
