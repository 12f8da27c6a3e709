"""Draw the hidden effects of each case at random, write them to sealed files, and publish hashes of these files."""

from collections.abc import Sequence
from pathlib import Path

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.suite import salt, truths
from virtual_phantom.study.job import job, log


def main(*, sealed_files: Sequence[str], seals_file: str, settings: ProofSettings) -> None:
    documents = [seal.sealed(truth, salt(settings.seed, truth["number"])) for truth in truths(settings).values()]
    for document, path in zip(documents, sealed_files, strict=True):
        seal.write(document, Path(path))
    seal.write(seal.publish(documents), seals_file)
    log.info("%d cases sealed", len(documents))


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed_files=snakemake.output.sealed,
            seals_file=snakemake.output.seals,
            settings=from_mapping(ProofSettings, snakemake.params.settings),
        )
