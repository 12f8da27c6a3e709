"""Reconstruct images of one protocol, from as many acquisitions together as the job has outputs."""

from collections.abc import Mapping, Sequence

from virtual_phantom.base.settings import FbpSettings, SirtSettings, VoxelSettings, from_mapping
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_file: str,
    clean_files: Sequence[str],
    levels: Sequence[str],
    roi_files: Sequence[str],
    physics_files: Sequence[str],
    outputs: Sequence[str],
    protocol: str,
    algorithm: str,
    settings: SirtSettings | FbpSettings,
    geometry_name: str,
    acquisitions: Sequence[Mapping],
    image_physics: Mapping,
    voxels: VoxelSettings | None,
    engine: str,
    model: str,
    draws: str,
    study_seed: int,
    mu_water_per_mm: float,
    zero_counts_as: float,
    threads: int,
) -> None:
    import numpy as np

    from virtual_phantom.base.errors import InputError
    from virtual_phantom.io.exchange import read_line_integrals
    from virtual_phantom.io.volumes import read_nifti, write_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.reconstruction.boxes import boxes_around, voxels_over
    from virtual_phantom.simulation.acquire import acquire
    from virtual_phantom.simulation.project import read_diagnosed_physics
    from virtual_phantom.simulation.reconstruct import reconstruct, reconstruct_in_boxes
    from virtual_phantom.study.matched_noise import resolve

    grid = read_nifti(phantom_file).grid
    paths = list(clean_files)
    physics = image_physics
    if physics_files:
        _, physics = read_diagnosed_physics(*physics_files)
    if physics and voxels is not None:
        raise InputError(
            f"{physics_files[0]}: {min(physics)} acts on whole images, and those of protocol "
            f"{protocol} are made in boxes; take its voxels out"
        )
    noisy, read, noise_free, geometries = None, None, {}, []
    for lane, (acquisition, path) in enumerate(zip(resolve(acquisitions, levels), paths, strict=True)):
        if path != read:
            clean, geometry = read_line_integrals(path)
            state, read = read_state(path), path
            if algorithm == "fbp" and settings.noise_kernel is not None:
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
    if voxels is not None:
        grid = voxels_over(grid, voxels.spacing_mm)
    # Lanes of one reconstruction share the start angle, and the position or the noise-free scan if it is needed.
    alike = [
        (float(scan.angles_rad[0]), *roi_files[lane : lane + 1], paths[lane] if noise_free else None)
        for lane, scan in enumerate(geometries)
    ]
    for kind in dict.fromkeys(alike):
        lanes = [lane for lane, other in enumerate(alike) if other == kind]
        line_integrals = noisy if len(lanes) == len(alike) else noisy[lanes]
        if voxels is None:
            volumes = reconstruct(
                line_integrals,
                geometries[lanes[0]],
                grid,
                algorithm,
                settings,
                engine=engine,
                mu_water_per_mm=mu_water_per_mm,
                physics=physics,
                clean=noise_free.get(paths[lanes[0]]),
                threads=threads,
            )
        else:
            _, masks = read_masks(roi_files[lanes[0]], grid)
            volumes = reconstruct_in_boxes(
                line_integrals,
                geometries[lanes[0]],
                grid,
                boxes_around(masks.values(), grid),
                settings,
                clean=noise_free.get(paths[lanes[0]]),
                thickness_mm=voxels.thickness_mm,
                engine=engine,
                mu_water_per_mm=mu_water_per_mm,
                threads=threads,
            )
        for lane, volume in zip(lanes, volumes, strict=True):
            write_nifti(volume, outputs[lane])


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.phantom,
            clean_files=snakemake.input.clean,
            levels=snakemake.input.levels,
            roi_files=snakemake.input.rois,
            physics_files=snakemake.input.physics,
            outputs=snakemake.output,
            protocol=snakemake.wildcards.protocol,
            algorithm=snakemake.params.algorithm,
            settings=from_mapping(SirtSettings | FbpSettings, snakemake.params.settings),
            geometry_name=snakemake.params.geometry,
            acquisitions=snakemake.params.acquisitions,
            image_physics=snakemake.params.physics,
            voxels=from_mapping(VoxelSettings, snakemake.params.voxels),
            engine=snakemake.params.engine,
            model=snakemake.params.model,
            draws=snakemake.params.draws,
            study_seed=snakemake.params.study_seed,
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
            zero_counts_as=snakemake.params.zero_counts_as,
            threads=snakemake.threads,
        )
