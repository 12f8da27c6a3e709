"""Scan one blind case by both protocols and write the recordings, which do not reveal the hidden effects."""

from collections.abc import Sequence

from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.generate import acquire, hidden_settings, scan_section, write, write_images
from virtual_phantom.proof.hiding.objects import OBJECTS
from virtual_phantom.proof.hiding.suite import PROTOCOLS, scan_seed, views_of
from virtual_phantom.proof.hiding.xcist import energy_of_water
from virtual_phantom.study.job import job


def main(
    *,
    sealed_file: str,
    seals_file: str,
    fine_file: str,
    folders: Sequence[str],
    case: str,
    settings: ProofSettings,
    mu_water_per_mm: float,
) -> None:
    truth = seal.open_seal(sealed_file, seal.read(seals_file))
    phantom_object = OBJECTS[truth["phantom"]]
    fine = read_nifti(fine_file)
    kev = energy_of_water(mu_water_per_mm)
    seeds = scan_seed(settings.seed, truth["number"]).spawn(2)
    hidden, numbers_of_views = hidden_settings(truth), views_of(truth["kind"], settings)
    for folder, protocol, views, seed in zip(folders, PROTOCOLS, numbers_of_views, seeds, strict=True):
        wanted = getattr(settings, protocol)
        scan = scan_section(phantom_object, settings.scan, views, wanted.photons, wanted.rotation_time_ms, kev, hidden)
        taken = acquire(scan, phantom_object, fine, mu_water_per_mm, wanted.repeats, seed)
        if truth["kind"] == "images":
            write_images(folder, case, phantom_object, scan, taken, mu_water_per_mm)
        else:
            write(folder, case, scan, taken)


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed_file=snakemake.input.sealed,
            seals_file=snakemake.input.seals,
            fine_file=snakemake.input.fine,
            folders=snakemake.output,
            case=snakemake.wildcards.case,
            settings=from_mapping(ProofSettings, snakemake.params.settings),
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
        )
