"""Tables of small images, written by pyradiomics' own batch command."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import SimpleITK as sitk
import warm
import yaml

PYRADIOMICS = Path(sys.executable).with_name("pyradiomics")
SPACING_MM = (1.5, 2.0, 3.0)  # x, y, z
SHAPE = (10, 16, 18)
LABELS = {"liver": 1, "cyst": 5}
# Settings of the study as a parameter file.
SAME = {"binWidth": 25, "minimumROIDimensions": 1}
CLASSES = {name: [] for name in ("firstorder", "glcm", "gldm", "glrlm", "glszm", "ngtdm", "shape")}


def batch(rows, out, setting=None, image_types=("Original",)):
    """Run `pyradiomics` on a batch of cases, dicts with Image and Mask, in the folder of the table."""
    cases, parameters = out.with_suffix(".cases.csv"), out.with_suffix(".yaml")
    pd.DataFrame(rows).to_csv(cases, index=False)
    content = {"imageType": {name: {} for name in image_types}, "featureClass": CLASSES, "setting": setting or SAME}
    parameters.write_text(yaml.safe_dump(content))
    command = [warm.python(), PYRADIOMICS, cases, "--param", parameters, "--format", "csv", "--out", out]
    process = subprocess.run([str(one) for one in command], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    cases.unlink()
    parameters.unlink()
    return out


def label_map() -> np.ndarray:
    labels = np.zeros(SHAPE, np.uint8)
    labels[2:8, 2:8, 2:9], labels[2:8, 9:15, 3:15] = LABELS["liver"], LABELS["cyst"]
    return labels


def write(array, path):
    image = sitk.GetImageFromArray(array)
    image.SetSpacing(SPACING_MM)
    path.parent.mkdir(parents=True, exist_ok=True)
    sitk.WriteImage(image, str(path))
    return path


def scans(folder, doses=(3, 10), repeats=3):
    """{(dose, repeat): path of a noisy image of two regions}, and their label map."""
    rng = np.random.default_rng(5)
    labels, paths = label_map(), {}
    write(labels, folder / "labels.nii.gz")
    for name, label in LABELS.items():
        write((labels == label).astype(np.uint8), folder / "masks" / f"{name}.nii.gz")
    for dose in doses:
        for repeat in range(repeats):
            image = rng.normal(0, 120 / dose**0.5, SHAPE) + 20 * labels
            paths[dose, repeat] = write(image.astype(np.float32), folder / f"dose{dose}" / f"r{repeat}.nii.gz")
    return paths
