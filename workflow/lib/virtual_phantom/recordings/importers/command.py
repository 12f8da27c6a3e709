"""Make a recording folder from another format (docs/how-to/recordings.md).

virtual-phantom-import htc2022 SINOGRAM.mat FOLDER [--segmentation S.mat]   Helsinki challenge
virtual-phantom-import features TABLE.csv FOLDER       a published table of features
virtual-phantom-import dicom TREE FOLDER [--kernel K]  a tree of DICOM series, one repeat each
virtual-phantom-import dicom-ct-pd SCAN FOLDER         a folder of DICOM-CT-PD files, one scan
virtual-phantom-import study results/projections/GEOMETRY/NOISE FOLDER   a study's acquisitions
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


def main(words: Sequence[str] | None = None) -> int:
    """Import what a command line asks for, and print what came in and what comes next; returns the exit code."""
    return run_command(run, words)


def run(words: Sequence[str]) -> int:
    """Import what these words ask for; errors are for the caller to print."""
    parser = argparse.ArgumentParser(
        prog="virtual-phantom-import",
        description=__doc__,
        epilog=f"{DEBUG}, anywhere on the line, prints the traceback of an error.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    formats = parser.add_subparsers(dest="format", required=True)
    for name in IMPORTERS:
        options = formats.add_parser(name)
        options.add_argument("source", help="what to read")
        options.add_argument("folder", help="recording folder to write; its name becomes the recording's")
        options.add_argument("--phantom", help="what was scanned, for recording.yaml")
        if name == "htc2022":
            options.add_argument("--segmentation", help="the data set's own (.mat): becomes object.nii.gz")
        if name == "dicom-ct-pd":
            swapped = "the files have the focal spot's shifts (7033,100B) and (7033,100C) swapped"
            options.add_argument("--swapped-shifts", action="store_true", help=swapped)
        if name == "dicom":
            options.add_argument("--kernel", help="take the series of this reconstruction kernel only")
            unchecked = "checks of the CT to leave out, as named in their lines, separated by commas"
            options.add_argument("--not-checked", default=(), type=lambda text: text.split(","), help=unchecked)
    arguments = vars(parser.parse_args(words))
    importer = IMPORTERS[arguments.pop("format")]
    recording = importer(arguments.pop("source"), arguments.pop("folder"), **arguments)
    print(readable(summary_table({recording.name: summarize_recording(recording)})))
    print(f"\n{next_steps(recording)}")
    return 0
