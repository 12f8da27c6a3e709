# What all acquisitions share.
NOISE = {
    "model": PLAN.config["noise"]["model"],
    "draws": PLAN.config["noise"]["draws"],
    "study_seed": PLAN.config["seed"],
}


rule compile_kernels:
    """Compile the kernels once for a number of realisations, so that no two jobs do it side by side."""
    input:
        code=code("compile_kernels.py"),
    output:
        f"{RESULTS}/logs/kernels/{{lanes}}.txt",
    log:
        f"{RESULTS}/logs/kernels/{{lanes}}.log",
    wildcard_constraints:
        lanes="[0-9]+",
    group:
        "preparation"
    resources:
        mem_mb=1000,
        runtime=10,
    script:
        "../scripts/compile_kernels.py"


rule project:
    """Noise-free line integrals of one geometry, shared by all its noise levels, seeds and algorithms."""
    input:
        phantom=rules.phantom.output.fine,
        image=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        kernels=f"{RESULTS}/logs/kernels/1.txt",
        effects=lambda wildcards: effect_code(
            *PLAN.geometry_settings(wildcards.geometry)["physics"]
        ),
        code=code("project.py"),
    output:
        f"{RESULTS}/projections/{{geometry}}/clean.h5",
    log:
        f"{RESULTS}/logs/project/{{geometry}}.log",
    benchmark:
        f"{RESULTS}/logs/project/{{geometry}}.benchmark.tsv"
    group:
        "preparation"
    threads: PLAN.config["threads"]
    resources:
        mem_mb=lambda wildcards: megabytes(
            # Materials are volumes of their own, packed and not.
            fine=9 if PLAN.geometry_settings(wildcards.geometry)["physics"] else 3,
            projections=8,
            scan=wildcards.geometry,
        ),
        runtime=lambda wildcards, attempt: attempt
        * minutes(RATES, *SIZES.projection(wildcards.geometry)),
    params:
        geometry=lambda wildcards: PLAN.geometry_settings(wildcards.geometry),
        mu_water_per_mm=PLAN.config["mu_water_per_mm"],
        materials=PLAN.config["materials"],
        sensor=PLAN.config["sensor"],
    script:
        "../scripts/project.py"


rule acquire:
    """One noisy acquisition as a file. Reconstruction draws the same counts itself; this is for keep_projections."""
    input:
        clean=f"{RESULTS}/projections/{{geometry}}/clean.h5",
        levels=lambda wildcards: level_files(wildcards.noise),
        code=code("acquire.py"),
    output:
        f"{RESULTS}/projections/{{geometry}}/{{noise}}/seed{{seed}}.h5",
    log:
        f"{RESULTS}/logs/acquire/{{geometry}}/{{noise}}/seed{{seed}}.log",
    group:
        "projections"
    resources:
        mem_mb=lambda wildcards: megabytes(projections=8, scan=wildcards.geometry),
        runtime=lambda wildcards, attempt: attempt
        * minutes(RATES, "acquire", SIZES.noise(wildcards.geometry)),
    params:
        **NOISE,
        acquisition=lambda wildcards: acquisition(wildcards.noise, wildcards.seed),
    script:
        "../scripts/acquire.py"
