"""Draw what is concealed in every case, seal it and publish the seals."""

from pathlib import Path

from virtual_phantom.proof.conceal import seal
from virtual_phantom.proof.conceal.suite import salt, truths
from virtual_phantom.study.job import job

with job(snakemake) as log:
    settings = snakemake.params.settings
    documents = [seal.sealed(truth, salt(settings["seed"], truth["number"])) for truth in truths(settings).values()]
    for document, path in zip(documents, snakemake.output.sealed, strict=True):
        seal.write(document, Path(path))
    seal.write(seal.publish(documents), snakemake.output.seals)
    log.info("%d cases sealed", len(documents))
