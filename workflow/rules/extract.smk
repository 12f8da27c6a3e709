for batch, levels in PLAN.seed_batches().items():

    rule:
        name:
            f"extract_seeds_{batch[0]}_to_{batch[-1]}"
        input:
            images=[
                f"{RESULTS}/images/{{protocol}}/{{noise}}/seed{seed}.nii.gz"
                for seed in batch
            ],
            levels=lambda wildcards: level_files(wildcards.noise),
            rois=rules.phantom.output.table,
            masks=rules.phantom.output.rois,
            code=code("extract.py"),
        output:
            [
                f"{RESULTS}/features/{{protocol}}/{{noise}}/seed{seed}.csv"
                for seed in batch
            ],
        log:
            f"{RESULTS}/logs/extract/{{protocol}}/{{noise}}/seed{batch[0]}_to_{batch[-1]}.log",
        wildcard_constraints:
            noise="|".join(levels),
        group:
            # Its images' job and all of its tables': a batch of seeds never lies in two bundles.
            lambda wildcards, batch=batch: acquisition_group(
                BUNDLE_OF[wildcards.protocol, wildcards.noise, batch[0]]
            )
        resources:
            mem_mb=megabytes(volumes=12),
            runtime=lambda wildcards, attempt, batch=batch: attempt
            * minutes(RATES, "extract", SIZES.images(len(batch))),
        params:
            protocol=lambda wildcards: wildcards.protocol,
            settings=lambda wildcards: {
                key: PLAN.config["protocols"][wildcards.protocol][key]
                for key in ("algorithm", "projections")
            },
            acquisitions=lambda wildcards, batch=batch: [
                acquisition(wildcards.noise, seed) for seed in batch
            ],
        script:
            "../scripts/extract.py"


rule merge_features:
    input:
        features=[
            f"{RESULTS}/features/{protocol}/{noise}/seed{seed}.csv"
            for protocol, noise in PLAN.featured()
            for seed in PLAN.seeds(noise)
        ],
        code=code("merge_features.py"),
    output:
        f"{RESULTS}/features.csv",
    log:
        f"{RESULTS}/logs/merge_features.log",
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=lambda wildcards, input, attempt: attempt
        * minutes(RATES, "merge_features", SIZES.images(len(input.features))),
    script:
        "../scripts/merge_features.py"
