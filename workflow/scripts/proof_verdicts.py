"""Bind every diagnosis by its hash, before any seal is opened."""

from pathlib import Path

from virtual_phantom.proof.conceal import seal
from virtual_phantom.study.job import job

with job(snakemake) as log:
    given = snakemake.input
    for diagnosis, other, path in zip(given.diagnoses, given.others, snakemake.output, strict=True):
        seal.write(seal.verdict_of(Path(path).stem, diagnosis, other), path)
