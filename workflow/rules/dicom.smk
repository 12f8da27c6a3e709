# Simulated images for programs that read DICOM.
try:
    DICOM = dicom_images()
except InputError as error:
    sys.exit(f"Error: {error}")


rule dicom_series:
    """One image as a CT series, its ROIs as a SEG beside it."""
    input:
        image=f"{RESULTS}/images/{{protocol}}/{{noise}}/seed{{seed}}.nii.gz",
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("dicom.py"),
    output:
        series=directory(f"{RESULTS}/dicom/{{protocol}}/{{noise}}/seed{{seed}}/series"),
        rois=f"{RESULTS}/dicom/{{protocol}}/{{noise}}/seed{{seed}}/rois.dcm",
    log:
        f"{RESULTS}/logs/dicom/{{protocol}}/{{noise}}/seed{{seed}}.log",
    resources:
        mem_mb=megabytes(volumes=12),
        runtime=15,
    params:
        scan=dicom_scan,
    script:
        "../scripts/dicom.py"


rule dicom:
    """Images as DICOM series."""
    input:
        exported,
    localrule: True
