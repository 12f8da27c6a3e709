"""The printed phantom's study from substitute scans on an S3 service, with one command.

To run it by hand, with every figure of config/printed_phantom.yaml at the size of config/tiny.yaml, and s5cmd and
moto_server in PATH:

    python tests/recordings/from_nothing.py FOLDER
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import yaml

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
if __name__ == "__main__":
    sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "workflow")]

import public_files  # noqa: E402
from pages import copy_project  # noqa: E402
from s3_service import BUCKET, service  # noqa: E402

from virtual_phantom.recordings.public_scans.table import select_scans  # noqa: E402

TABLE = "workflow/lib/virtual_phantom/resources/public_scans.csv"
TANDEM = {"collection": "ct_phantom4radiomics"}
GRID = {"shape": [24, 84, 84], "spacing_mm": [4.0, 3.75, 3.75]}  # margin around the scanned object: 80 x 80


def kind():
    """moto if both programs are installed, otherwise a replacement of s5cmd that copies files."""
    return "moto" if shutil.which("moto_server") and shutil.which("s5cmd") else "stand_in"


@contextlib.contextmanager
def substituted_scans(folder, phantom, compared, of=None):
    """A copy of the project whose list has the substitute scans, and a service that has them.

        phantom, compared   selections, as under public_scans
        of                  service; default as returned by `kind`

    Yields (project, settings, variables, truth): settings on top of config/printed_phantom.yaml, variables of a
    process, and the scanned objects: the drawn phantom and {name of a scan: its image}.
    """
    project, bucket = folder / "project", folder / "s3" / BUCKET
    copy_project(ROOT, project)
    scans = list(dict.fromkeys(select_scans(phantom, "phantom") + select_scans(compared, "compared")))
    drawn, images, masks = public_files.simulated(len(scans))
    by_name = {scan.name: image for scan, image in zip(scans, images, strict=True)}
    scans = public_files.write_bucket(scans, bucket, lambda scan: by_name[scan.name], masks)
    public_files.write_table(scans, project / TABLE)
    with service(of or kind(), folder / "s3") as one:
        one.begin()
        for scan in scans:
            for series in scan.series:
                one.put(series)
        settings = {
            "public_scans": {"phantom": phantom, "compared": compared},
            "downloads": {"endpoint": one.endpoint},
            "grid": GRID,
            "scan": {"columns": 108},
        }
        yield project, settings, one.variables, (drawn, by_name)


def main(folder):
    """Make all figures and print the time on two cores."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    phantom = TANDEM | {"groups": [8], "acquisitions": [1, 2, 3, 4, 5]}
    compared = TANDEM | {"groups": [3, 4, 8], "acquisitions": [11, 12, 13]}
    with substituted_scans(folder, phantom, compared) as (project, settings, variables, _):
        (project / "mine.yaml").write_text(yaml.safe_dump(settings | {"results_dir": "results"}))
        command = [sys.executable, "-m", "snakemake", "--cores", "2", "--configfile", "config/printed_phantom.yaml"]
        command += ["config/tiny.yaml", "mine.yaml"]
        environment = os.environ | variables | {"PYTHONPATH": str(project / "workflow" / "lib")}
        began = time.monotonic()
        code = subprocess.run(command, cwd=project, env=environment, check=False).returncode
        print(f"{kind()}: code {code}, {(time.monotonic() - began) / 60:.1f} min, {project}")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
