"""Make a recording folder from another format (docs/recordings.md). Run it by hand:

python workflow/scripts/import_recording.py htc2022 SINOGRAM.mat FOLDER [--segmentation S.mat]   Helsinki challenge
python workflow/scripts/import_recording.py features TABLE.csv FOLDER       a published table of features
python workflow/scripts/import_recording.py dicom TREE FOLDER [--kernel K]  a tree of DICOM series, one repeat each
python workflow/scripts/import_recording.py study results/projections/GEOMETRY/NOISE FOLDER   a study's acquisitions
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "lib"))

from virtual_phantom.base.errors import InputError
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree
from virtual_phantom.recordings.importers.feature_tables import import_features
from virtual_phantom.recordings.importers.htc2022 import import_htc2022
from virtual_phantom.recordings.importers.study import import_study
from virtual_phantom.recordings.summary import readable, summary, table

IMPORTERS = {"htc2022": import_htc2022, "features": import_features, "dicom": import_dicom_tree, "study": import_study}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    formats = parser.add_subparsers(dest="format", required=True)
    for name in IMPORTERS:
        options = formats.add_parser(name)
        options.add_argument("source", help="what to read")
        options.add_argument("folder", help="recording folder to write; its name becomes the recording's")
        options.add_argument("--phantom", help="what was scanned, for recording.yaml")
        if name == "htc2022":
            options.add_argument("--segmentation", help="the data set's own (.mat): becomes object.nii.gz")
        if name == "dicom":
            options.add_argument("--kernel", help="take the series of this reconstruction kernel only")
    arguments = vars(parser.parse_args())
    run = IMPORTERS[arguments.pop("format")]
    try:
        recording = run(arguments.pop("source"), arguments.pop("folder"), **arguments)
    except InputError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    print(readable(table({recording.name: summary(recording)})))
    return 0


if __name__ == "__main__":
    sys.exit(main())
