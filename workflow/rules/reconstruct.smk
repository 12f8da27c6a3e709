# One rule for each bundle of noise levels and seeds: one job makes all images of a bundle.
acquisitions = context.acquisitions


for number, (bundle, protocols) in enumerate(context.plan.bundles().items()):

    rule:
        name:
            f"reconstruct_{number}"
        input:
            clean=lambda wildcards, bundle=bundle: [
                acquisitions.clean(
                    context.plan.geometry_of(wildcards.protocol), noise, seed
                )
                for noise, seed in bundle
            ],
            levels=acquisitions.level_files(noise for noise, _ in bundle),
            phantom=rules.phantom.output.image,
            rois=lambda wildcards, bundle=bundle: acquisitions.box_rois(
                wildcards.protocol, bundle
            )[0],
            masks=lambda wildcards, bundle=bundle: acquisitions.box_rois(
                wildcards.protocol, bundle
            )[1],
            kernels=results(f"logs/kernels/{len(bundle)}.txt"),
            physics=lambda wildcards: context.diagnosis.found_physics(
                context.study.protocols[wildcards.protocol].physics_from
            ),
        output:
            [
                (
                    results(f"images/{{protocol}}/{noise}/seed{seed}.nii.gz")
                    if context.study.keep_images
                    else temp(
                        results(f"images/{{protocol}}/{noise}/seed{seed}.nii.gz")
                    )
                )
                for noise, seed in bundle
            ],
        log:
            results(f"logs/reconstruct/{{protocol}}_{number}.log"),
        benchmark:
            results(f"logs/reconstruct/{{protocol}}_{number}.benchmark.tsv")
        wildcard_constraints:
            protocol="|".join(protocols),
        group:
            acquisitions.group(bundle)
        threads: context.study.threads
        resources:
            mem_mb=lambda wildcards, bundle=bundle: context.megabytes(
                volumes=6,
                volume_lanes=len(bundle),
                projections=2,
                projection_lanes=len(bundle) + 4,
                geometry=context.plan.geometry_of(wildcards.protocol),
            ),
            runtime=lambda wildcards, attempt, bundle=bundle: attempt
            * context.minutes(
                *context.sizes.reconstruction(wildcards.protocol, len(bundle))
            ),
            gpu=int(context.engine == "astra_cuda"),
        params:
            **acquisitions.noise,
            algorithm=lambda wildcards: acquisitions.algorithm(wildcards.protocol),
            settings=lambda wildcards: to_mapping(
                acquisitions.settings(wildcards.protocol)
            ),
            geometry=lambda wildcards: context.plan.geometry_of(wildcards.protocol),
            acquisitions=[
                acquisitions.acquisition(noise, seed) for noise, seed in bundle
            ],
            physics=lambda wildcards: acquisitions.image_physics(wildcards.protocol),
            voxels=lambda wildcards: to_mapping(
                context.study.protocols[wildcards.protocol].voxels
            ),
            engine=context.engine,
            mu_water_per_mm=context.study.mu_water_per_mm,
            zero_counts_as=context.study.noise.zero_counts_as,
            code=lambda wildcards: code(
                "reconstruct.py",
                acquisitions.image_physics(wildcards.protocol),
            ),
        script:
            "../scripts/reconstruct.py"
