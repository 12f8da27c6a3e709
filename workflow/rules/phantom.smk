rule mean_scan:
    """Mean of public scans as phantom, without the patient table; regions by majority."""
    input:
        scans=context.scans.folders(context.scans.scanned),
    output:
        image=results("public_scans/mean.nii.gz"),
        regions=results("public_scans/regions.nii.gz"),
        table=results("public_scans/scans.csv"),
        spectra=results("public_scans/spectra.csv"),
    log:
        results("logs/mean_scan.log"),
    resources:
        mem_mb=6000,
        runtime=60,
    params:
        scans=context.scans.scanned,
        regions=context.study.public_scans.regions,
        grid=to_mapping(context.study.grid),
        code=code("mean_scan.py"),
    script:
        "../scripts/mean_scan.py"


rule without_own_blur:
    """Deblur the mean of public scans where the object exceeds the noise."""
    input:
        image=rules.mean_scan.output.image,
        regions=rules.mean_scan.output.regions,
        spectra=rules.mean_scan.output.spectra,
    output:
        image=results("public_scans/sharp.nii.gz"),
        table=results("public_scans/own_blur.csv"),
    log:
        results("logs/without_own_blur.log"),
    resources:
        mem_mb=6000,
        runtime=60,
    params:
        slice_mm=context.scans.slice_mm,
        grid=to_mapping(context.study.grid),
        regions=context.study.public_scans.regions,
        code=code("without_own_blur.py"),
    script:
        "../scripts/without_own_blur.py"


rule phantom:
    """The phantom that all scans share, and its ROIs."""
    input:
        sources=context.phantom.files(),
    output:
        image=results("phantom/image.nii.gz"),
        fine=results("phantom/fine.nii.gz"),
        table=results("phantom/rois.csv"),
        rois=directory(results("phantom/rois")),
    log:
        results("logs/phantom.log"),
    group:
        "preparation"
    resources:
        mem_mb=context.megabytes(volumes=4, fine=6),
        runtime=lambda wildcards, attempt: attempt
        * context.minutes("phantom", context.sizes.phantom()),
    params:
        phantom=to_mapping(context.study.phantom),
        grid=to_mapping(context.study.grid),
        seed=context.study.seed,
        mu_water_per_mm=context.study.mu_water_per_mm,
        code=code("phantom.py"),
    script:
        "../scripts/phantom.py"


rule positions:
    """Position of the phantom in each repeat."""
    output:
        results("phantom/positions.csv"),
    log:
        results("logs/positions.log"),
    group:
        "preparation"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        repeats=context.acquisitions.positions(),
        code=code("positions.py"),
    script:
        "../scripts/positions.py"


rule rois_on_voxels:
    """ROIs on the voxels of a scanner, drawn as on the grid of the study."""
    input:
        sources=context.phantom.files(),
        fine=rules.phantom.output.fine,
        image=rules.phantom.output.image,
    output:
        table=results("phantom/{voxels}/rois.csv"),
        rois=directory(results("phantom/{voxels}/rois")),
    log:
        results("logs/rois_on_voxels/{voxels}.log"),
    wildcard_constraints:
        voxels="voxels_[0-9a-z_]+",
    group:
        "preparation"
    resources:
        mem_mb=context.megabytes(volumes=8, fine=4),
        runtime=30,
    params:
        phantom=to_mapping(context.study.phantom),
        seed=context.study.seed,
        pose=None,
        spacing_mm=lambda wildcards: context.plan.voxel_spacing(wildcards.voxels),
        code=code("rois_on_voxels.py"),
    script:
        "../scripts/rois_on_voxels.py"


use rule rois_on_voxels as rois_moved with:
    # ROIs of a re-positioned scan, on the voxels of the study or of a scanner.
    output:
        table=results("phantom/moved/seed{seed}/{voxels}/rois.csv"),
        rois=directory(results("phantom/moved/seed{seed}/{voxels}/rois")),
    log:
        results("logs/rois_moved/seed{seed}_{voxels}.log"),
    wildcard_constraints:
        voxels="grid|voxels_[0-9a-z_]+",
    params:
        phantom=to_mapping(context.study.phantom),
        seed=context.study.seed,
        pose=lambda wildcards: context.acquisitions.pose(wildcards.seed),
        spacing_mm=lambda wildcards: context.plan.voxel_spacing(wildcards.voxels),
        code=code("rois_on_voxels.py"),
