"""Draw and seal the hidden effects of each case, publish the hashes of these files, and register the run."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.suite import salt, truths
from virtual_phantom.proof.scoring.registration import log_run, registration
from virtual_phantom.study.job import job, log


def main(
    *,
    sealed_files: Sequence[str],
    seals_file: str,
    registration_file: str,
    runs_file: str,
    settings: ProofSettings,
    registered_settings: Mapping,
) -> None:
    drawn = list(truths(settings).values())
    documents = [seal.sealed(truth, salt(settings.seed, truth["number"])) for truth in drawn]
    for document, path in zip(documents, sealed_files, strict=True):
        seal.write(document, Path(path))
    seal.write(seal.publish(documents), seals_file)
    registered = registration(registered_settings, drawn, seals_file)
    seal.write(registered, registration_file)
    log_run(runs_file, "registered", registered)
    log.info("%d cases sealed, seed %d, commit %s", len(documents), registered["seed"], registered["commit"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed_files=snakemake.output.sealed,
            seals_file=snakemake.output.seals,
            registration_file=snakemake.output.registration,
            runs_file=snakemake.params.runs,
            settings=from_mapping(ProofSettings, snakemake.params.settings),
            registered_settings=snakemake.params.registered,
        )
