"""Write the stated object of a case of the blind validation, as its diagnosis gets it."""

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.proof.hiding import stated_object
from virtual_phantom.proof.hiding.suite import World
from virtual_phantom.study.job import job


def main(*, folder: str, world: World, settings: ProofSettings) -> None:
    stated_object.write(folder, world.stated(settings.seed), world.orbits(settings))


if "snakemake" in globals():
    with job(snakemake):
        main(
            folder=snakemake.output[0],
            world=World(**snakemake.params.world),
            settings=from_mapping(ProofSettings, snakemake.params.settings),
        )
