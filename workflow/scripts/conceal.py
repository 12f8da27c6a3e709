"""Scan one concealed case by both protocols and write the recordings, which say nothing of what is concealed."""

from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.proof.conceal import seal
from virtual_phantom.proof.conceal.generate import acquire, concealed_settings, scan_section, write, write_images
from virtual_phantom.proof.conceal.objects import OBJECTS
from virtual_phantom.proof.conceal.suite import PROTOCOLS, scan_seed, views_of
from virtual_phantom.proof.conceal.xcist import energy_of_water
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, case = snakemake.params, snakemake.wildcards.case
    truth = seal.open_seal(snakemake.input.sealed, seal.read(snakemake.input.seals))
    one = OBJECTS[truth["phantom"]]
    fine = read_nifti(snakemake.input.fine)
    kev = energy_of_water(params.mu_water_per_mm)
    seeds = scan_seed(params.settings["seed"], truth["number"]).spawn(2)
    concealed, many = concealed_settings(truth), views_of(truth["kind"], params.settings)
    for folder, protocol, views, seed in zip(snakemake.output, PROTOCOLS, many, seeds, strict=True):
        photons, rotation_ms, repeats = (
            params.settings[protocol][key] for key in ("photons", "rotation_time_ms", "repeats")
        )
        scan = scan_section(one, params.settings["scan"], views, photons, rotation_ms, kev, concealed)
        taken = acquire(scan, one, fine, params.mu_water_per_mm, repeats, seed)
        if truth["kind"] == "images":
            write_images(folder, case, one, scan, taken, params.mu_water_per_mm)
        else:
            write(folder, case, scan, taken)
