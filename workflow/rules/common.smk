"""Configuration, wildcards and targets that all rules share."""

import os
import sys

LIBRARY = os.path.join(workflow.basedir, "workflow", "lib")
sys.path.insert(0, LIBRARY)
# Scripts run in processes of their own and find the library by this.
os.environ.update(
    PYTHONPATH=os.pathsep.join([LIBRARY, *filter(None, [os.environ.get("PYTHONPATH")])])
)

from virtual_phantom.config import check
from virtual_phantom.dependencies import files_behind
from virtual_phantom.errors import InputError
from virtual_phantom.files import check_unchanged, files_of
from virtual_phantom.plan import Plan
from virtual_phantom.projectors import choose_engine

try:
    for path in workflow.configfiles:
        check_unchanged(path, "make it anew")
    PLAN = Plan(
        check(
            config,
            os.path.join(workflow.basedir, "workflow", "schemas", "config.schema.yaml"),
        )
    )
    ENGINE = choose_engine(
        PLAN.config["engine"], PLAN.config["reconstruction"]["sirt"]["backprojector"]
    )
except InputError as error:
    sys.exit(f"Error: {error}")

RESULTS = PLAN.config["results_dir"].rstrip("/")
ACQUISITIONS = PLAN.acquisitions()
ANALYSES = PLAN.config["analyses"]


wildcard_constraints:
    protocol="[A-Za-z0-9_]+",
    geometry="[A-Za-z0-9_]+",
    noise="[A-Za-z0-9_]+",
    seed="[0-9]{2}",


def code(script):
    """A script and the library files behind it, as inputs of its rule. Relative, so that a moved folder stays valid."""
    return [
        os.path.relpath(path)
        for path in files_behind(
            os.path.join(workflow.basedir, "workflow", "scripts", script)
        )
    ]


def effect_code(*effects):
    """The files of effects and what is behind them: they are imported by name, so that `code` does not see them."""
    files = {
        path
        for effect in effects
        for path in files_behind(
            os.path.join(LIBRARY, "virtual_phantom/physics/effects", f"{effect}.py")
        )
    }
    return [os.path.relpath(path) for path in sorted(files)]


def megabytes(
    *, volumes=0, volume_lanes=1, projections=0, projection_lanes=1, fine=0, scan=None
):
    """Memory of a job from the arrays that it holds, with room for Python and its libraries, MB."""
    voxels = 1
    for n in PLAN.config["grid"]["shape"]:
        voxels *= n
    floats = (
        volumes * volume_lanes * voxels
        + fine * voxels * PLAN.config["grid"]["oversampling"] ** 3
    )
    if scan:
        settings = PLAN.geometry_settings(scan)
        pixels = (
            settings["scan"]["rows"]
            * settings["scan"]["columns"]
            * settings["projections"]
        )
        floats += projections * projection_lanes * pixels
    return int(600 + 1.3 * floats * 4 / 1e6)


def images(protocol, noise):
    return [
        f"{RESULTS}/images/{protocol}/{noise}/seed{seed}.nii.gz"
        for seed in PLAN.seeds(noise)
    ]


def figure(name):
    return multiext(f"{RESULTS}/figures/{name}", ".png", ".pdf")


def tables():
    """Every table that the configuration asks for, without its suffix."""
    wanted = []
    if "noise_calibration" in ANALYSES:
        wanted.append("noise_calibration")
    if "stability" in ANALYSES:
        wanted += ["stability", "stability_measures", "stable_features", "top_features"]
        if PLAN.config["measured"]["overlay"]:
            wanted.append("overlap")
        wanted += [f"overlap_{name}" for name in ANALYSES["stability"]["recordings"]]
    for name in ANALYSES.get("pca", {}):
        wanted += [f"pca_{name}", f"separability_{name}"]
    for name, comparison in ANALYSES.get("comparison", {}).items():
        wanted += [
            f"comparison_{name}{part}" for part in ("", "_features", "_families")
        ]
        if comparison["attribute"]:
            wanted += [f"attribution_{name}", f"attribution_{name}_cells"]
    if any("meets" in level for level in PLAN.config["noise"]["levels"].values()):
        wanted.append("matched_noise")
    features = [f"{RESULTS}/features"] if PLAN.featured() else []
    return features + [f"{RESULTS}/tables/{name}" for name in wanted]


def targets():
    """Everything that the configuration asks for."""
    wanted = [figure("rois")]
    wanted += [table + suffix for table in tables() for suffix in (".csv", ".parquet")]
    if "optimal" in ANALYSES:
        wanted.append(figure("scans"))
    if "noise_calibration" in ANALYSES:
        wanted.append(figure("noise_calibration"))
    if "stability" in ANALYSES:
        wanted.append(figure("stability_discrimination"))
        if PLAN.config["measured"]["overlay"]:
            wanted.append(figure("overlap"))
    wanted += [figure(f"pca_{name}") for name in ANALYSES.get("pca", {})]
    for name, comparison in ANALYSES.get("comparison", {}).items():
        wanted.append(figure(f"comparison_{name}"))
        if comparison["attribute"]:
            wanted.append(figure(f"attribution_{name}"))
    wanted += [
        figure(f"overlap_{name}")
        for name in ANALYSES.get("stability", {}).get("recordings", [])
    ]
    if PLAN.config["keep_projections"]:
        wanted += [
            f"{RESULTS}/projections/{PLAN.geometry_of(protocol)}/{noise}/seed{seed}.h5"
            for protocol, noise in ACQUISITIONS
            for seed in PLAN.seeds(noise)
        ]
    return wanted


include: "common_study.smk"
include: "common_recordings.smk"
include: "common_proof.smk"
include: "common_pages.smk"
