KERNELS = [f"projectors/{name}.py" for name in ("kernels", "parallel", "lanes")]


rule compile_kernels:
    """Compile the kernels once for a number of realisations, so that no two jobs do it side by side."""
    input:
        code=library(*KERNELS),
    output:
        f"{RESULTS}/logs/kernels/{{lanes}}.txt",
    log:
        f"{RESULTS}/logs/kernels/{{lanes}}.log",
    wildcard_constraints:
        lanes="[0-9]+",
    resources:
        mem_mb=1000,
        runtime=10,
    script:
        "../scripts/compile_kernels.py"


rule project:
    """Noise-free line integrals of one geometry, shared by all its noise levels, seeds and algorithms."""
    input:
        phantom=rules.phantom.output.fine,
        kernels=f"{RESULTS}/logs/kernels/1.txt",
        code=library(
            "geometry.py",
            "units.py",
            "simulate.py",
            "config.py",
            "exchange.py",
            "projectors/cpu.py",
            *KERNELS,
        ),
    output:
        f"{RESULTS}/projections/{{geometry}}/clean.h5",
    log:
        f"{RESULTS}/logs/project/{{geometry}}.log",
    benchmark:
        f"{RESULTS}/logs/project/{{geometry}}.benchmark.tsv"
    threads: PLAN.config["threads"]
    resources:
        mem_mb=lambda wildcards: megabytes(
            fine=3, projections=3, scan=wildcards.geometry
        ),
        runtime=60,
    params:
        geometry=lambda wildcards: PLAN.geometry_settings(wildcards.geometry),
        grid=PLAN.config["grid"],
        mu_water_per_mm=PLAN.config["mu_water_per_mm"],
    script:
        "../scripts/project.py"


for batch, levels in PLAN.seed_batches().items():

    rule:
        name:
            f"acquire_seeds_{batch[0]}_to_{batch[-1]}"
        input:
            clean=f"{RESULTS}/projections/{{geometry}}/clean.h5",
            code=library("physics/noise.py", "exchange.py"),
        output:
            [
                (
                    f"{RESULTS}/projections/{{geometry}}/{{noise}}/seed{seed}.h5"
                    if PLAN.config["keep_projections"]
                    else temp(
                        f"{RESULTS}/projections/{{geometry}}/{{noise}}/seed{seed}.h5"
                    )
                )
                for seed in batch
            ],
        log:
            f"{RESULTS}/logs/acquire/{{geometry}}/{{noise}}/seed{batch[0]}_to_{batch[-1]}.log",
        wildcard_constraints:
            noise="|".join(levels),
        resources:
            mem_mb=lambda wildcards: megabytes(projections=6, scan=wildcards.geometry),
            runtime=30,
        params:
            seeds=[int(seed) for seed in batch],
            noise_level=lambda wildcards: PLAN.config["noise"]["levels"][
                wildcards.noise
            ]["A"],
            model=PLAN.config["noise"]["model"],
            study_seed=PLAN.config["seed"],
        script:
            "../scripts/acquire.py"
