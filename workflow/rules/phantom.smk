rule mean_scan:
    """The mean of public scans, which is then the phantom: without the table, with the regions of most of them."""
    input:
        scans=context.scans.folders(context.scans.scanned),
        code=context.code("mean_scan.py"),
    output:
        image=context.file("mean_scan"),
        regions=context.file("mean_regions"),
        table=context.file("mean_table"),
        spectra=context.file("mean_spectra"),
    log:
        context.log("mean_scan"),
    resources:
        mem_mb=6000,
        runtime=60,
    params:
        scans=context.scans.scanned,
        regions=context.scans.regions,
        grid=context.config["grid"],
    script:
        "../scripts/mean_scan.py"


rule without_own_blur:
    """The mean of public scans before its own scanner blurred it, as far as it shows more object than noise."""
    input:
        image=rules.mean_scan.output.image,
        regions=rules.mean_scan.output.regions,
        spectra=rules.mean_scan.output.spectra,
        code=context.code("without_own_blur.py"),
    output:
        image=context.file("sharp_scan"),
        table=context.file("own_blur"),
    log:
        context.log("without_own_blur"),
    resources:
        mem_mb=6000,
        runtime=60,
    params:
        slice_mm=context.scans.slice_mm,
        grid=context.config["grid"],
        regions=context.scans.regions,
    script:
        "../scripts/without_own_blur.py"


rule phantom:
    """The object that every scan sees, and its ROIs."""
    input:
        sources=context.phantom.files(),
        code=context.code("phantom.py"),
    output:
        image=context.file("phantom_image"),
        fine=context.file("phantom_fine"),
        table=context.file("phantom_table"),
        rois=directory(context.file("phantom_rois")),
    log:
        context.log("phantom"),
    group:
        "preparation"
    resources:
        mem_mb=context.megabytes(volumes=4, fine=6),
        runtime=lambda wildcards, attempt: attempt
        * context.minutes("phantom", context.sizes.phantom()),
    params:
        phantom=context.config["phantom"],
        grid=context.config["grid"],
        seed=context.config["seed"],
        mu_water_per_mm=context.config["mu_water_per_mm"],
    script:
        "../scripts/phantom.py"


rule positions:
    """Where the phantom lies in every repeat."""
    input:
        code=context.code("positions.py"),
    output:
        context.file("positions"),
    log:
        context.log("positions"),
    group:
        "preparation"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        repeats=context.acquisitions.positions(),
    script:
        "../scripts/positions.py"


rule rois_on_voxels:
    """The ROIs on the voxels of a scanner, drawn as those on the study's grid are."""
    input:
        sources=context.phantom.files(),
        fine=rules.phantom.output.fine,
        image=rules.phantom.output.image,
        code=context.code("rois_on_voxels.py"),
    output:
        table=context.file("voxel_table"),
        rois=directory(context.file("voxel_rois")),
    log:
        context.log("rois_on_voxels/{voxels}"),
    wildcard_constraints:
        voxels="voxels_[0-9a-z_]+",
    group:
        "preparation"
    resources:
        mem_mb=context.megabytes(volumes=8, fine=4),
        runtime=30,
    params:
        phantom=context.config["phantom"],
        seed=context.config["seed"],
        pose=None,
        spacing_mm=lambda wildcards: context.plan.voxel_spacing(wildcards.voxels),
    script:
        "../scripts/rois_on_voxels.py"


rule rois_moved:
    """The ROIs of a re-positioned repeat, on the study's voxels or on those of a scanner."""
    input:
        sources=context.phantom.files(),
        fine=rules.phantom.output.fine,
        image=rules.phantom.output.image,
        code=context.code("rois_on_voxels.py"),
    output:
        table=context.file("moved_table"),
        rois=directory(context.file("moved_rois")),
    log:
        context.log("rois_moved/seed{seed}_{voxels}"),
    wildcard_constraints:
        voxels="grid|voxels_[0-9a-z_]+",
    group:
        "preparation"
    resources:
        mem_mb=context.megabytes(volumes=8, fine=4),
        runtime=30,
    params:
        phantom=context.config["phantom"],
        seed=context.config["seed"],
        pose=lambda wildcards: context.acquisitions.pose(wildcards.seed),
        spacing_mm=lambda wildcards: context.plan.voxel_spacing(wildcards.voxels),
    script:
        "../scripts/rois_on_voxels.py"
