"""Reconstruct the images of all protocols and acquisitions of a job."""

from collections.abc import Mapping, Sequence

from virtual_phantom.base.settings import ImageSettings, from_mapping
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_file: str,
    clean_files: Sequence[str],
    levels: Sequence[str],
    roi_files: Sequence[str],
    physics_files: Sequence[str],
    outputs: Sequence[str],
    images: Sequence[ImageSettings],
    geometry_name: str,
    acquisitions: Sequence[Mapping],
    engine: str,
    noise: Mapping,
    mu_water_per_mm: float,
    zero_counts_as: float,
    threads: int,
) -> None:
    from dataclasses import replace

    import numpy as np

    from virtual_phantom.base.errors import InputError
    from virtual_phantom.io.exchange import read_line_integrals
    from virtual_phantom.io.volumes import read_nifti, write_nifti
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.simulation.acquire import acquire
    from virtual_phantom.simulation.project import read_diagnosed_physics
    from virtual_phantom.simulation.reconstruct import NoisyScans, reconstruct_images
    from virtual_phantom.study.matched_noise import resolve

    grid = read_nifti(phantom_file).grid
    paths = list(clean_files)
    if physics_files:
        _, found = read_diagnosed_physics(*physics_files)
        images = [replace(image, physics=found) for image in images]
    for image in images:
        if image.physics and image.voxels is not None:
            raise InputError(
                f"{physics_files[0]}: {min(image.physics)} acts on whole images, but the images of protocol "
                f"{image.protocol} are boxes around ROIs; remove its key voxels"
            )
    keep_clean = any(image.algorithm == "fbp" and image.settings.noise_kernel for image in images)
    noisy, read, noise_free, geometries = None, None, {}, []
    for lane, (acquisition, path) in enumerate(zip(resolve(acquisitions, levels), paths, strict=True)):
        if path != read:
            clean, geometry = read_line_integrals(path)
            state, read = read_state(path), path
            if keep_clean:
                noise_free[path] = clean
        geometries.append(geometry)
        if noisy is None:
            noisy = np.empty((len(paths), *clean.shape), dtype=np.float32)
        counts = acquire(clean, geometry=geometry_name, state=state, **noise, **acquisition)
        noisy[lane] = counts.line_integrals(zero_counts_as)
        log.info(
            "%s: fewest counts %d, pixels without any %d", acquisition, counts.data.min(), (counts.data == 0).sum()
        )
    del clean, counts
    scans = NoisyScans(noisy, geometries, paths, noise_free)
    roi_tables = iter(roi_files)
    tables = {image.protocol: [next(roi_tables) for _ in paths] for image in images if image.voxels}
    files = {image.protocol: outputs[i * len(paths) :][: len(paths)] for i, image in enumerate(images)}
    settings = {"engine": engine, "mu_water_per_mm": mu_water_per_mm, "threads": threads}
    for protocol, lane, volume in reconstruct_images(images, scans, grid, tables, **settings):
        write_nifti(volume, files[protocol][lane])


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.phantom,
            clean_files=snakemake.input.clean,
            levels=snakemake.input.levels,
            roi_files=snakemake.input.rois,
            physics_files=snakemake.input.physics,
            outputs=snakemake.output,
            images=[from_mapping(ImageSettings, image) for image in snakemake.params.images],
            geometry_name=snakemake.params.geometry,
            acquisitions=snakemake.params.acquisitions,
            engine=snakemake.params.engine,
            noise=snakemake.params.noise,
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
            zero_counts_as=snakemake.params.zero_counts_as,
            threads=snakemake.threads,
        )
