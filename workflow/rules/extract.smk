for batch, levels in context.plan.seed_batches().items():

    rule:
        name:
            f"extract_seeds_{batch[0]}_to_{batch[-1]}"
        input:
            images=[
                results(f"images/{{protocol}}/{{noise}}/seed{seed}.nii.gz")
                for seed in batch
            ],
            levels=lambda wildcards: context.acquisitions.level_files([wildcards.noise]),
            rois=lambda wildcards, batch=batch: [
                context.acquisitions.rois(wildcards.protocol, wildcards.noise, seed)[0]
                for seed in batch
            ],
            masks=lambda wildcards, batch=batch: [
                context.acquisitions.rois(wildcards.protocol, wildcards.noise, seed)[1]
                for seed in batch
            ],
            parameters=context.parameter_files,
        output:
            [
                results(f"features/{{protocol}}/{{noise}}/seed{seed}.csv")
                for seed in batch
            ],
        log:
            results(
                f"logs/extract/{{protocol}}/{{noise}}/seed{batch[0]}_to_{batch[-1]}.log"
            ),
        wildcard_constraints:
            noise="|".join(levels),
        group:
            # The group of the images and of all their tables, since no batch of seeds is in two bundles.
            lambda wildcards, batch=batch: context.acquisitions.group_of(
                wildcards.protocol, wildcards.noise, batch[0]
            )
        resources:
            mem_mb=context.megabytes(volumes=12),
            runtime=lambda wildcards, attempt, batch=batch: attempt
            * context.minutes("extract", context.sizes.images(len(batch))),
        params:
            parameters=context.parameters,
            protocol=lambda wildcards: wildcards.protocol,
            algorithm=lambda wildcards: context.study.protocols[
                wildcards.protocol
            ].algorithm,
            projections=lambda wildcards: context.study.protocols[
                wildcards.protocol
            ].projections,
            acquisitions=lambda wildcards, batch=batch: [
                context.acquisitions.acquisition(wildcards.noise, seed)
                for seed in batch
            ],
            code=code("extract.py"),
        script:
            "../scripts/extract.py"


rule merge_features:
    input:
        features=context.acquisitions.feature_tables(),
    output:
        results("features.csv"),
    log:
        results("logs/merge_features.log"),
    group:
        "analyses"
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
