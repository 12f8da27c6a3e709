"""One simulated image as a DICOM CT series, and its ROIs as a DICOM SEG."""

from virtual_phantom.io import dicom_export, volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job

with job(snakemake) as log:
    paths, output = snakemake.input, snakemake.output
    image, phantom = volumes.read_nifti(paths.image), volumes.read_nifti(paths.phantom)
    _, masks = read_masks(paths.rois, image.grid)
    slices = dicom_export.series(image, phantom, dicom_export.Scan(**snakemake.params.scan))
    dicom_export.write_series(slices, output.series)
    dicom_export.write(dicom_export.segmentation(slices, masks), output.rois)
    log.info("%d slices, series %s, %d ROIs", len(slices), slices[0].SeriesInstanceUID, len(masks))
