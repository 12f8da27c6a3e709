from virtual_phantom.config.plan import MOVED, STILL


rule compile_kernels:
    """Compile the kernels of a step for a number of noise realizations, so that no two jobs compile at one time."""
    output:
        results("logs/kernels/{step}_{lanes}.txt"),
    log:
        results("logs/kernels/{step}_{lanes}.log"),
    wildcard_constraints:
        step="project|sirt|fbp",
        lanes="[0-9]+",
    group:
        "preparation"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        method=lambda wildcards: {
            "sirt": context.study.reconstruction.sirt.backprojector,
            "fbp": context.study.reconstruction.fbp.normalise,
        }.get(wildcards.step),
        code=code("compile_kernels.py"),
    script:
        "../scripts/compile_kernels.py"


rule project:
    """Noise-free line integrals of a geometry, or of a repeat with its own position or start angle."""
    input:
        phantom=rules.phantom.output.fine,
        image=rules.phantom.output.image,
        rois=lambda wildcards: context.acquisitions.scan_rois(wildcards.scan)[0],
        masks=lambda wildcards: context.acquisitions.scan_rois(wildcards.scan)[1],
        kernels=results("logs/kernels/project_1.txt"),
        physics=lambda wildcards: context.diagnosis.found_physics(
            context.plan.geometry_settings(wildcards.geometry).physics_from
        ),
    output:
        results("projections/{geometry}/{scan}.h5"),
    log:
        results("logs/project/{geometry}_{scan}.log"),
    benchmark:
        results("logs/project/{geometry}_{scan}.benchmark.tsv")
    wildcard_constraints:
        scan=f"clean(_({MOVED}|{STILL})[0-9]{{2}})?",
    group:
        "preparation"
    threads: context.study.threads
    resources:
        mem_mb=lambda wildcards: context.megabytes(
            # Each material has a volume, packed and unpacked.
            fine=9 if context.plan.has_physics(wildcards.geometry) else 3,
            projections=8,
            geometry=wildcards.geometry,
        ),
        runtime=lambda wildcards, attempt: attempt
        * context.minutes(*context.sizes.projection(wildcards.geometry)),
    params:
        geometry=lambda wildcards: to_mapping(
            context.plan.geometry_settings(wildcards.geometry)
        ),
        mu_water_per_mm=context.study.mu_water_per_mm,
        materials=to_mapping(context.study.materials),
        sensor=to_mapping(context.study.sensor),
        pose=lambda wildcards: context.acquisitions.scan_pose(wildcards.scan),
        start_angle_deg=lambda wildcards: context.acquisitions.scan_start_angle_deg(
            wildcards.scan
        ),
        code=lambda wildcards: code(
            "project.py", context.diagnosis.effects_of(wildcards.geometry)
        ),
    script:
        "../scripts/project.py"


rule acquire:
    """One noisy acquisition as a file, for keep_projections. The reconstruction draws the same counts itself."""
    input:
        clean=lambda wildcards: context.acquisitions.clean(
            wildcards.geometry, wildcards.noise, wildcards.seed
        ),
        levels=lambda wildcards: context.acquisitions.level_files([wildcards.noise]),
    output:
        results("projections/{geometry}/{noise}/seed{seed}.h5"),
    log:
        results("logs/acquire/{geometry}/{noise}/seed{seed}.log"),
    group:
        "projections"
    resources:
        mem_mb=lambda wildcards: context.megabytes(
            projections=8, geometry=wildcards.geometry
        ),
        runtime=lambda wildcards, attempt: attempt
        * context.minutes("acquire", context.sizes.noise(wildcards.geometry)),
    params:
        noise=context.acquisitions.noise,
        acquisition=lambda wildcards: context.acquisitions.acquisition(
            wildcards.noise, wildcards.seed
        ),
        code=code("acquire.py"),
    script:
        "../scripts/acquire.py"
