"""Write one simulated image as a DICOM CT series, and its ROIs as a DICOM SEG."""

from collections.abc import Mapping

from virtual_phantom.io import dicom_export, volumes
from virtual_phantom.phantom import read_masks
from virtual_phantom.study.job import job, log


def main(
    *,
    image_file: str,
    phantom_file: str,
    rois_file: str,
    series_folder: str,
    segments_file: str,
    scan: Mapping,
) -> None:
    image, phantom = volumes.read_nifti(image_file), volumes.read_nifti(phantom_file)
    _, masks = read_masks(rois_file, image.grid)
    slices = dicom_export.series(image, phantom, dicom_export.Scan(**scan))
    dicom_export.write_series(slices, series_folder)
    dicom_export.write(dicom_export.segmentation(slices, masks), segments_file)
    log.info("%d slices, series %s, %d ROIs", len(slices), slices[0].SeriesInstanceUID, len(masks))


if "snakemake" in globals():
    with job(snakemake):
        main(
            image_file=snakemake.input.image,
            phantom_file=snakemake.input.phantom,
            rois_file=snakemake.input.rois,
            series_folder=snakemake.output.series,
            segments_file=snakemake.output.rois,
            scan=snakemake.params.scan,
        )
