"""Write regions like the study that published the scans: with pydicom-seg 0.4.1 in a separate environment.

    python -m venv seg && seg/bin/pip install -r tests/recordings/environment-pydicom-seg.txt
    seg/bin/python tests/recordings/write_with_pydicom_seg.py SERIES LABELS.npz OUT.dcm SERIES_UID

LABELS.npz holds `labels`, [slice from inferior, row, column], and `names` of the labels 1, 2, ...
"""

import sys
from pathlib import Path

import numpy as np
import pydicom
import pydicom_seg
import SimpleITK as sitk

CODE = {"CodeValue": "85756007", "CodingSchemeDesignator": "SCT", "CodeMeaning": "Tissue"}


def main(series, labels, out, uid):
    slices = [pydicom.dcmread(path) for path in sorted(Path(series).iterdir())]
    slices.sort(key=lambda one: float(one.ImagePositionPatient[2]))
    archive = np.load(labels)
    image = sitk.GetImageFromArray(archive["labels"].astype(np.uint8))
    row, column = map(float, slices[0].PixelSpacing)
    z = [float(one.ImagePositionPatient[2]) for one in slices]
    image.SetSpacing((column, row, (z[-1] - z[0]) / (len(z) - 1)))
    image.SetOrigin([float(value) for value in slices[0].ImagePositionPatient])
    described = [
        {
            "labelID": number,
            "SegmentLabel": str(name),
            "SegmentDescription": str(name),
            "SegmentAlgorithmType": "MANUAL",
            "SegmentedPropertyCategoryCodeSequence": CODE,
            "SegmentedPropertyTypeCodeSequence": CODE,
            "recommendedDisplayRGBValue": [255, 0, 0],
        }
        for number, name in enumerate(archive["names"], start=1)
    ]
    template = pydicom_seg.template.from_dcmqi_metainfo(
        {
            "ContentCreatorName": "Reader",
            "SeriesDescription": f"{slices[0].SeriesDescription} - SEG",
            "SeriesNumber": str(slices[0].SeriesNumber),
            "InstanceNumber": "1",
            "BodyPartExamined": "ABDOMEN",
            "segmentAttributes": [described],
        }
    )
    writer = pydicom_seg.MultiClassWriter(template, inplane_cropping=False, skip_empty_slices=True)
    dataset = writer.write(image, slices)
    dataset.SeriesInstanceUID = uid
    dataset.save_as(out)


main(*sys.argv[1:])
