"""Compute how well an ideal observer sees the hidden effects of one blind case."""

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.visibility import snr
from virtual_phantom.study.job import job


def main(
    *, sealed_file: str, seals_file: str, visibility_file: str, settings: ProofSettings, mu_water_per_mm: float
) -> None:
    truth = seal.open_seal(sealed_file, seal.read(seals_file))
    seal.write(snr(truth, settings, mu_water_per_mm), visibility_file)


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed_file=snakemake.input.sealed,
            seals_file=snakemake.input.seals,
            visibility_file=snakemake.output[0],
            settings=from_mapping(ProofSettings, snakemake.params.settings),
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
        )
