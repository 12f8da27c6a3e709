"""Convert another format to a recording folder (docs/how-to/recordings.md).

virtual-phantom-import htc2022 SINOGRAM.mat FOLDER [--segmentation S.mat]   Helsinki Tomography Challenge 2022
virtual-phantom-import features TABLE.csv FOLDER       published table of features
virtual-phantom-import dicom TREE FOLDER [--kernel K]  folder tree of DICOM series, one repeat each
virtual-phantom-import dicom-ct-pd SCAN FOLDER         folder of DICOM-CT-PD files, one scan
virtual-phantom-import study results/projections/GEOMETRY/NOISE FOLDER   acquisitions of a study
"""

import argparse
from collections.abc import Sequence

from ...base.console import DEBUG, run_command
from ..summary import readable, summarize_recording, summary_table
from .dicom_ct_pd import import_dicom_ct_pd
from .dicom_tree import import_dicom_tree
from .feature_tables import import_features
from .htc2022 import import_htc2022
from .next_steps import next_steps
from .study import import_study

IMPORTERS = {
    "htc2022": import_htc2022,
    "features": import_features,
    "dicom": import_dicom_tree,
    "dicom-ct-pd": import_dicom_ct_pd,
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
        if name == "dicom":
            options.add_argument("--kernel", help="import only the series with this reconstruction kernel")
            unchecked = "checks of the CT to skip, as named in their messages, separated by commas"
            options.add_argument("--not-checked", default=(), type=lambda text: text.split(","), help=unchecked)
    options = vars(parser.parse_args(arguments))
    importer = IMPORTERS[options.pop("format")]
    recording = importer(options.pop("source"), options.pop("folder"), **options)
    print(readable(summary_table({recording.name: summarize_recording(recording)})))
    print(f"\n{next_steps(recording)}")
    return 0
