"""Scan one blind case by both protocols; write its stated object and the recordings, which reveal no hidden effect."""

from collections.abc import Sequence

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.proof.hiding import seal, stated_object
from virtual_phantom.proof.hiding.generate import (
    ENERGY_OF_WATER,
    acquire,
    hidden_settings,
    scan_of,
    write,
    write_images,
)
from virtual_phantom.proof.hiding.orbits import image_grid
from virtual_phantom.proof.hiding.suite import IMAGES, PROTOCOLS, World, scan_seed
from virtual_phantom.study.job import job


def main(
    *,
    sealed_file: str,
    seals_file: str,
    object_folder: str,
    folders: Sequence[str],
    case: str,
    settings: ProofSettings,
    mu_water_per_mm: float,
) -> None:
    truth = seal.open_seal(sealed_file, seal.read(seals_file))
    world = World.of(truth)
    stated, kev = world.stated(settings.seed), ENERGY_OF_WATER[world.simulator](mu_water_per_mm)
    orbits = world.orbits(settings)
    stated_object.write(object_folder, stated, orbits)
    seeds = scan_seed(settings.seed, world.number).spawn(2)
    hidden, errors = hidden_settings(truth), truth["imperfections"]
    for folder, protocol, orbit, seed in zip(folders, PROTOCOLS, orbits, seeds, strict=True):
        wanted = getattr(settings, protocol)
        scan = scan_of(orbit, wanted.photons, wanted.rotation_time_ms, kev, hidden)
        taken = acquire(world.simulator, scan, stated, errors, mu_water_per_mm, wanted.repeats, seed)
        if world.kind == IMAGES:
            write_images(folder, case, image_grid(orbit), scan, taken, mu_water_per_mm)
        else:
            write(folder, case, orbit, wanted.rotation_time_ms, taken, mu_water_per_mm)


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed_file=snakemake.input.sealed,
            seals_file=snakemake.input.seals,
            object_folder=snakemake.output.stated,
            folders=[snakemake.output.recording, snakemake.output.other],
            case=snakemake.wildcards.case,
            settings=from_mapping(ProofSettings, snakemake.params.settings),
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
        )
