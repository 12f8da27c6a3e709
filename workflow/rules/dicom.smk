# Simulated images for programs that read DICOM.
from virtual_phantom.study.context import or_exit


rule dicom_series:
    """One image as a DICOM CT series, with its ROIs as a DICOM SEG."""
    input:
        image=results("images/{protocol}/{noise}/seed{seed}.nii.gz"),
        phantom=rules.phantom.output.image,
        rois=lambda wildcards: context.acquisitions.rois(
            wildcards.protocol, wildcards.noise, wildcards.seed
        )[0],
        masks=lambda wildcards: context.acquisitions.rois(
            wildcards.protocol, wildcards.noise, wildcards.seed
        )[1],
    output:
        series=directory(results("dicom/{protocol}/{noise}/seed{seed}/series")),
        rois=results("dicom/{protocol}/{noise}/seed{seed}/rois.dcm"),
    log:
        results("logs/dicom/{protocol}/{noise}/seed{seed}.log"),
    resources:
        mem_mb=context.megabytes(volumes=12),
        runtime=15,
    params:
        scan=lambda wildcards: context.pages.series(
            wildcards.protocol, wildcards.noise, wildcards.seed
        ),
        code=code("dicom.py"),
    script:
        "../scripts/dicom.py"


rule dicom:
    """All requested images as DICOM series."""
    input:
        or_exit(lambda wildcards: context.pages.exported_files()),
    localrule: True
