"""Convert another format to a recording folder (docs/how-to/recordings.md).

virtual-phantom-import htc2022 SINOGRAM.mat FOLDER [--segmentation S.mat]   Helsinki Tomography Challenge 2022
virtual-phantom-import features TABLE.csv FOLDER       published table of features
virtual-phantom-import dicom TREE FOLDER [--kernel K]  folder tree of DICOM series, one repeat each
virtual-phantom-import dicom-ct-pd SCAN FOLDER         folder of DICOM-CT-PD files, one scan
virtual-phantom-import projections ARRAY FOLDER        TIFF or PNG stack, .npy, .mat, HDF5 (Data Exchange, NeXus)
virtual-phantom-import xtekct FILE.xtekct FOLDER       Nikon parameter file and its images
virtual-phantom-import study results/projections/GEOMETRY/NOISE FOLDER   acquisitions of a study
"""

import argparse
import re
from collections.abc import Sequence

from ...base.console import DEBUG, run_command
from ..summary import readable, summarize_recording, summary_table
from .dicom_ct_pd import import_dicom_ct_pd
from .dicom_tree import import_dicom_tree
from .feature_tables import import_features
from .htc2022 import import_htc2022
from .next_steps import next_steps
from .projections import UNITS, import_projections
from .study import import_study
from .xtekct import import_xtekct

IMPORTERS = {
    "htc2022": import_htc2022,
    "features": import_features,
    "dicom": import_dicom_tree,
    "dicom-ct-pd": import_dicom_ct_pd,
    "projections": import_projections,
    "xtekct": import_xtekct,
    "study": import_study,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Import a recording, print its summary and the next steps; return the exit code."""
    return run_command(run, arguments)


def run(arguments: Sequence[str]) -> int:
    """Run the importer; the caller prints errors."""
    parser = argparse.ArgumentParser(
        prog="virtual-phantom-import",
        description=__doc__,
        epilog=f"{DEBUG}, anywhere on the command line, prints the traceback of an error.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    formats = parser.add_subparsers(dest="format", required=True)
    for name in IMPORTERS:
        options = formats.add_parser(name)
        options.add_argument("source", help="file or folder to import")
        options.add_argument("folder", help="recording folder to write; its name becomes the name of the recording")
        options.add_argument("--phantom", help="scanned object, for recording.yaml")
        if name == "htc2022":
            options.add_argument("--segmentation", help="segmentation of the data set (.mat); becomes object.nii.gz")
        if name == "dicom-ct-pd":
            swapped = "use if the files have the focal spot's shifts (7033,100B) and (7033,100C) swapped"
            options.add_argument("--swapped-shifts", action="store_true", help=swapped)
        if name == "projections":
            _add_array_options(options)
        if name == "xtekct":
            options.add_argument("--images", help="folder of the images (default: the folder of the parameter file)")
        if name in ("projections", "xtekct"):
            options.add_argument("--flat", help="file, or number, of the counts without an object")
            options.add_argument("--dark", help="file, or number, of the counts without X-rays")
            options.add_argument("--bin", type=int, default=1, metavar="N", help="average N x N pixels to one")
        if name == "dicom":
            options.add_argument("--kernel", help="import only the series with this reconstruction kernel")
            unchecked = "checks of the CT to skip, as named in their messages, separated by commas"
            options.add_argument("--not-checked", default=(), type=lambda text: text.split(","), help=unchecked)
            options.add_argument("--one-slice", action="store_true", help="accept series of a single slice")
    options = vars(parser.parse_args(_with_negative_angles(arguments)))
    importer = IMPORTERS[options.pop("format")]
    recording = importer(options.pop("source"), options.pop("folder"), **options)
    print(readable(summary_table({recording.name: summarize_recording(recording)})))
    print(f"\n{next_steps(recording)}")
    return 0


def _with_negative_angles(arguments: Sequence[str]) -> list[str]:
    """Join --angles and a negative start, which argparse takes for another option."""
    words = list(arguments)
    for index in range(len(words) - 1):
        if words[index] == "--angles" and re.match(r"-[0-9.]", words[index + 1]):
            return [*words[:index], f"--angles={words[index + 1]}", *words[index + 2 :]]
    return words


def _add_array_options(options: argparse.ArgumentParser) -> None:
    options.add_argument("--dataset", help="variable of a .mat or .npz file, or path in an HDF5 file")
    axes = "letter of each axis: v view, r row, c column; a capital letter reverses the axis (default: vrc, or vc)"
    options.add_argument("--axes", help=axes)
    air = "columns at either edge that see air only; they replace the flat field"
    options.add_argument("--air-columns", type=int, default=0, metavar="N", help=air)
    options.add_argument("--log", action="store_true", help="the values are line integrals, -ln(I/I0)")
    options.add_argument("--angles", help="START,STEP in degrees, a file with one angle per view, or unknown")
    options.add_argument("--beam", choices=("divergent", "parallel"), default="divergent")
    options.add_argument("--source-to-axis", type=float, help="distance from the source to the rotation axis")
    options.add_argument("--source-to-detector", type=float, help="distance from the source to the detector")
    options.add_argument(
        "--pixel", type=float, nargs="+", default=(1.0,), help="width, or width and height, of a pixel"
    )
    unit = "unit of these lengths (default: mm); element: detector elements, if the scale is not known"
    options.add_argument("--unit", choices=tuple(UNITS), default="mm", help=unit)
    options.add_argument("--tube-kvp", type=float, help="tube voltage, kV")
    options.add_argument("--energy-kev", type=float, help="energy of a monochromatic beam, keV")
    options.add_argument(
        "--not-checked", default=(), type=lambda text: text.split(","), help="size: accept any lengths"
    )
