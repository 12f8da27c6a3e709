# One rule for each bundle and each set of protocols, as in reconstruct.smk.
for number, (bundle, protocols, constraint) in enumerate(
    context.acquisitions.rules(context.plan.acquisitions_with_features())
):

    rule:
        name:
            f"extract_{number}"
        input:
            unpack(
                lambda wildcards, bundle=bundle, protocols=protocols: context.acquisitions.image_rois(
                    named(protocols, wildcards), bundle
                )
            ),
            images=[
                results(f"images/{protocol}/{noise}/seed{seed}.nii.gz")
                for protocol in protocols
                for noise, seed in bundle
            ],
            levels=context.acquisitions.level_files(noise for noise, _ in bundle),
            parameters=context.parameter_files,
        output:
            [
                results(f"features/{protocol}/{noise}/seed{seed}.csv")
                for protocol in protocols
                for noise, seed in bundle
            ],
        log:
            results(f"logs/extract/{protocols[0]}_{number}.log"),
        wildcard_constraints:
            protocol=constraint,
        group:
            context.acquisitions.group(bundle)
        resources:
            mem_mb=context.megabytes(volumes=12),
            runtime=lambda wildcards, attempt, images=len(bundle) * len(
                protocols
            ): attempt
            * context.minutes("extract", context.sizes.images(images)),
        params:
            parameters=context.parameters,
            images=lambda wildcards, bundle=bundle, protocols=protocols: [
                {
                    "protocol": protocol,
                    "algorithm": context.study.protocols[protocol].algorithm,
                    "projections": context.study.protocols[protocol].projections,
                    **context.acquisitions.acquisition(noise, seed),
                }
                for protocol in named(protocols, wildcards)
                for noise, seed in bundle
            ],
            boxed=lambda wildcards, bundle=bundle, protocols=protocols: [
                context.study.protocols[protocol].voxels is not None
                for protocol in named(protocols, wildcards)
                for _ in bundle
            ],
            code=code("extract.py"),
        script:
            "../scripts/extract.py"


rule merge_features:
    # In no group: with each table that is ready, Snakemake looks at all inputs of the jobs of a group.
    input:
        features=context.acquisitions.feature_tables(),
    output:
        results("features.csv"),
    log:
        results("logs/merge_features.log"),
    resources:
        mem_mb=2000,
        runtime=lambda wildcards, input, attempt: attempt
        * context.minutes("merge_features", context.sizes.images(len(input.features))),
    params:
        code=code("merge_features.py"),
    script:
        "../scripts/merge_features.py"


rule setting_features:
    """Features of the images of one protocol and noise level with one extraction setting changed."""
    input:
        unpack(
            lambda wildcards: context.selections.setting_images(
                wildcards.protocol, wildcards.noise
            )
        ),
        parameters=context.parameter_files,
    output:
        results("extraction/{setting}/{protocol}/{noise}.csv"),
    log:
        results("logs/setting_features/{setting}/{protocol}/{noise}.log"),
    wildcard_constraints:
        setting="|".join(context.plan.variations) or "none",
    resources:
        mem_mb=context.megabytes(volumes=12),
        runtime=lambda wildcards, input, attempt: attempt
        * context.minutes("extract", context.sizes.images(len(input.images))),
    params:
        parameters=context.parameters,
        variation=lambda wildcards: to_mapping(
            context.plan.variations[wildcards.setting]
        ),
        seeds=lambda wildcards, input: list(range(len(input.images))),
        boxed=lambda wildcards: context.study.protocols[wildcards.protocol].voxels
        is not None,
        code=code("setting_features.py"),
    script:
        "../scripts/setting_features.py"
