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
    model: str,
    draws: str,
    study_seed: int,
    mu_water_per_mm: float,
    zero_counts_as: float,
    threads: int,
) -> None:
    from dataclasses import replace

    import numpy as np

    from virtual_phantom.base.errors import InputError
    from virtual_phantom.io.exchange import read_line_integrals
    from virtual_phantom.io.volumes import read_nifti, write_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.reconstruction.boxes import boxes_around, voxels_over, whole
    from virtual_phantom.reconstruction.images import filtered
    from virtual_phantom.simulation.acquire import acquire
    from virtual_phantom.simulation.project import read_diagnosed_physics
    from virtual_phantom.simulation.reconstruct import back_project, reconstruct
    from virtual_phantom.study.matched_noise import resolve

    grid = read_nifti(phantom_file).grid
    paths = list(clean_files)
    if physics_files:
        _, found = read_diagnosed_physics(*physics_files)
        images = [replace(image, physics=found) for image in images]
    for image in images:
        if image.physics and image.voxels is not None:
            raise InputError(
                f"{physics_files[0]}: {min(image.physics)} acts on whole images, and those of protocol "
                f"{image.protocol} are made in boxes; take its voxels out"
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
        counts = acquire(
            clean,
            geometry=geometry_name,
            model=model,
            draws=draws,
            study_seed=study_seed,
            state=state,
            **acquisition,
        )
        noisy[lane] = counts.line_integrals(zero_counts_as)
        log.info(
            "%s: fewest counts %d, pixels without any %d", acquisition, counts.data.min(), (counts.data == 0).sum()
        )
    del clean, counts
    common = {"mu_water_per_mm": mu_water_per_mm, "threads": threads}
    roi_tables = iter(roi_files)
    tables = {image.protocol: [next(roi_tables) for _ in paths] for image in images if image.voxels}
    files = {image.protocol: outputs[i * len(paths) :][: len(paths)] for i, image in enumerate(images)}
    for settings in dict.fromkeys(image.settings for image in images):
        alike = [image for image in images if image.settings == settings]
        filters_first = alike[0].algorithm == "fbp" and settings.normalise == "coverage"
        # Lanes of one reconstruction share the start angle; for FBP, also the position and the noise-free scan. On a
        # GPU, filtered projections of one lane at a time save memory.
        if not filters_first:
            keys = [float(scan.angles_rad[0]) for scan in geometries]
        else:
            keys = paths if engine == "cpu" else range(len(paths))
        for key in dict.fromkeys(keys):
            lanes = [lane for lane, other in enumerate(keys) if other == key]
            line_integrals, geometry = noisy if len(lanes) == len(keys) else noisy[lanes], geometries[lanes[0]]
            if filters_first:
                projections = filtered(line_integrals, geometry, settings, noise_free.get(paths[lanes[0]]), engine)
            for image in alike:
                if not filters_first:
                    volumes = reconstruct(
                        line_integrals,
                        geometry,
                        grid,
                        image.algorithm,
                        settings,
                        engine=engine,
                        physics=image.physics,
                        **common,
                    )
                elif image.voxels is None:
                    volumes = back_project(projections, grid, whole(grid), physics=image.physics, **common)
                else:
                    voxels = voxels_over(grid, image.voxels.spacing_mm)
                    _, masks = read_masks(tables[image.protocol][lanes[0]], voxels)
                    boxes = boxes_around(masks.values(), voxels)
                    volumes = back_project(projections, voxels, boxes, thickness_mm=image.voxels.thickness_mm, **common)
                for lane, volume in zip(lanes, volumes, strict=True):
                    write_nifti(volume, files[image.protocol][lane])
            projections = None  # frees memory before the next filter


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
            model=snakemake.params.model,
            draws=snakemake.params.draws,
            study_seed=snakemake.params.study_seed,
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
            zero_counts_as=snakemake.params.zero_counts_as,
            threads=snakemake.threads,
        )
