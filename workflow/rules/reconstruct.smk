BUNDLE_OF = {
    (protocol, *one): bundle
    for bundle, protocols in PLAN.bundles().items()
    for protocol in protocols
    for one in bundle
}


# One rule per distinct bundle of noise levels and seeds: all its images come out of one job.
for number, (bundle, protocols) in enumerate(PLAN.bundles().items()):

    rule:
        name:
            f"reconstruct_{number}"
        input:
            clean=lambda wildcards: f"{RESULTS}/projections/{PLAN.geometry_of(wildcards.protocol)}/clean.h5",
            levels=level_files(*(noise for noise, _ in bundle)),
            phantom=f"{RESULTS}/phantom/image.nii.gz",
            kernels=f"{RESULTS}/logs/kernels/{len(bundle)}.txt",
            effects=lambda wildcards: effect_code(*image_physics(wildcards)),
            code=code("reconstruct.py"),
        output:
            [
                image_file(f"{RESULTS}/images/{{protocol}}/{noise}/seed{seed}.nii.gz")
                for noise, seed in bundle
            ],
        log:
            f"{RESULTS}/logs/reconstruct/{{protocol}}_{number}.log",
        benchmark:
            f"{RESULTS}/logs/reconstruct/{{protocol}}_{number}.benchmark.tsv"
        wildcard_constraints:
            protocol="|".join(protocols),
        group:
            acquisition_group(bundle)
        threads: PLAN.config["threads"]
        resources:
            mem_mb=lambda wildcards, bundle=bundle: megabytes(
                volumes=6,
                volume_lanes=len(bundle),
                projections=2,
                projection_lanes=len(bundle) + 4,
                scan=PLAN.geometry_of(wildcards.protocol),
            ),
            runtime=lambda wildcards, attempt, bundle=bundle: attempt
            * minutes(RATES, *SIZES.reconstruction(wildcards.protocol, len(bundle))),
            gpu=lambda wildcards: int(
                ENGINE == "astra_cuda"
                and PLAN.config["protocols"][wildcards.protocol]["algorithm"] == "sirt"
            ),
        params:
            **NOISE,
            algorithm=lambda wildcards: PLAN.config["protocols"][wildcards.protocol][
                "algorithm"
            ],
            settings=lambda wildcards: PLAN.config["reconstruction"][
                PLAN.config["protocols"][wildcards.protocol]["algorithm"]
            ],
            geometry=lambda wildcards: PLAN.geometry_of(wildcards.protocol),
            acquisitions=[acquisition(noise, seed) for noise, seed in bundle],
            physics=image_physics,
            engine=ENGINE,
            mu_water_per_mm=PLAN.config["mu_water_per_mm"],
            zero_counts_as=PLAN.config["noise"]["zero_counts_as"],
        script:
            "../scripts/reconstruct.py"
