# Rules of the images: one for each bundle of noise levels and seeds, and one for each set of protocols with a common job.
for number, (bundle, protocols, constraint) in enumerate(context.acquisitions.rules()):

    rule:
        name:
            f"reconstruct_{number}"
        input:
            unpack(
                lambda wildcards, bundle=bundle, protocols=protocols: context.acquisitions.image_rois(
                    named(protocols, wildcards), bundle, boxes=True
                )
            ),
            clean=lambda wildcards, bundle=bundle, protocols=protocols: [
                context.acquisitions.clean(
                    context.plan.geometry_of(named(protocols, wildcards)[0]),
                    noise,
                    seed,
                )
                for noise, seed in bundle
            ],
            levels=context.acquisitions.level_files(noise for noise, _ in bundle),
            phantom=rules.phantom.output.image,
            kernels=lambda wildcards, bundle=bundle, protocols=protocols: context.acquisitions.kernels(
                named(protocols, wildcards)[0], bundle
            ),
            physics=lambda wildcards, protocols=protocols: context.diagnosis.found_physics(
                context.study.protocols[named(protocols, wildcards)[0]].physics_from
            ),
        output:
            [
                path if context.study.keep_images else temp(path)
                for protocol in protocols
                for noise, seed in bundle
                for path in [results(f"images/{protocol}/{noise}/seed{seed}.nii.gz")]
            ],
        log:
            results(f"logs/reconstruct/{protocols[0]}_{number}.log"),
        benchmark:
            results(f"logs/reconstruct/{protocols[0]}_{number}.benchmark.tsv")
        wildcard_constraints:
            protocol=constraint,
        group:
            context.acquisitions.group(bundle)
        threads: context.study.threads
        resources:
            mem_mb=lambda wildcards, bundle=bundle, protocols=protocols: context.megabytes(
                volumes=6,
                volume_lanes=len(bundle),
                projections=2,
                projection_lanes=len(bundle) + 4,
                geometry=context.plan.geometry_of(named(protocols, wildcards)[0]),
            ),
            runtime=lambda wildcards, attempt, bundle=bundle, protocols=protocols: attempt
            * context.minutes(
                *context.sizes.reconstruction(named(protocols, wildcards), len(bundle))
            ),
            gpu=int(context.engine == "astra_cuda"),
        params:
            noise=context.acquisitions.noise,
            images=lambda wildcards, protocols=protocols: [
                to_mapping(context.acquisitions.reconstruction(protocol))
                for protocol in named(protocols, wildcards)
            ],
            geometry=lambda wildcards, protocols=protocols: context.plan.geometry_of(
                named(protocols, wildcards)[0]
            ),
            acquisitions=[
                context.acquisitions.acquisition(noise, seed) for noise, seed in bundle
            ],
            engine=context.engine,
            mu_water_per_mm=context.study.mu_water_per_mm,
            zero_counts_as=context.study.noise.zero_counts_as,
            code=lambda wildcards, protocols=protocols: code(
                "reconstruct.py",
                {
                    name
                    for protocol in named(protocols, wildcards)
                    for name in context.acquisitions.reconstruction(protocol).physics
                },
            ),
        script:
            "../scripts/reconstruct.py"
