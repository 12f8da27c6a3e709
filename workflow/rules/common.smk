"""Configuration, wildcards and targets that all rules share."""

import os
import sys
from pathlib import Path

# Where these rules lie, whoever's Snakefile uses them and wherever it runs.
RULES = workflow.current_basedir.get_path_or_uri(secret_free=True)
if not os.path.isdir(RULES):
    sys.exit(
        f"Error: {RULES}: the rules need the library beside them; clone the repository and name the workflow/Snakefile of "
        "the clone by its path"
    )
WORKFLOW = Path(RULES).parent
LIBRARY = str(WORKFLOW / "lib")
# The library beside the rules, whether one is installed or not: they change together. Scripts run in processes of their
# own and find it by the variable.
sys.path.insert(0, LIBRARY)
os.environ.update(
    PYTHONPATH=os.pathsep.join([LIBRARY, *filter(None, [os.environ.get("PYTHONPATH")])])
)

from virtual_phantom.study import analyses
from virtual_phantom.study.config import check
from virtual_phantom.study.costs.jobs import Sizes
from virtual_phantom.study.costs.limits import minutes
from virtual_phantom.study.costs.rates import read_rates
from virtual_phantom.study.dependencies import files_behind
from virtual_phantom.base.data import RESOURCES, SCHEMAS
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.files import check_unchanged, files_of
from virtual_phantom.io.schema import SCHEMA
from virtual_phantom.study.plan import Plan
from virtual_phantom.projectors import choose_engine

try:
    for path in workflow.configfiles:
        check_unchanged(path, "make it again")
    PLAN = Plan(check(config, SCHEMA))
    # On a cluster, jobs that need no device may be where there is none.
    ENGINE = choose_engine(
        PLAN.config["engine"],
        PLAN.config["reconstruction"]["sirt"]["backprojector"],
        look=workflow.is_main_process,
    )
    RATES = read_rates(RESOURCES / "rates.yaml")
except InputError as error:
    sys.exit(f"Error: {error}")

RESULTS = PLAN.config["results_dir"].rstrip("/")
ACQUISITIONS = PLAN.acquisitions()
ANALYSES = PLAN.config["analyses"]
# What rules ask of a cluster follows from these.
SIZES = Sizes(PLAN, ENGINE)


wildcard_constraints:
    protocol="[A-Za-z0-9_]+",
    geometry="[A-Za-z0-9_]+",
    noise="[A-Za-z0-9_]+",
    seed="[0-9]{2}",


def shipped(path):
    """A file of the workflow as an input. Relative, so that a moved folder stays valid."""
    return os.path.relpath(path)


def resource(name):
    """A table or a layout that comes with the library, as an input."""
    return shipped(RESOURCES / name)


def code(script):
    """A script and the library files behind it, as inputs of its rule."""
    return [shipped(path) for path in files_behind(WORKFLOW / "scripts" / script)]


def effect_code(*effects):
    """The files of effects and what is behind them: they are imported by name, so that `code` does not see them."""
    files = {
        path
        for effect in effects
        for path in files_behind(
            os.path.join(LIBRARY, "virtual_phantom/physics/effects", f"{effect}.py")
        )
    }
    return [shipped(path) for path in sorted(files)]


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


def analysed(folder):
    """Files in a folder of the results that the configuration asks for."""
    return [
        f"{RESULTS}/{file}"
        for _, _, files, _ in analyses.jobs(PLAN)
        for file in files
        if os.path.dirname(file) == folder
    ]


def tables():
    """Every table that the configuration asks for, without its suffix."""
    features = [f"{RESULTS}/features"] if PLAN.featured() else []
    return features + [file.removesuffix(".csv") for file in analysed("tables")]


def targets():
    """Everything that the configuration asks for."""
    wanted = analysed("figures")
    wanted += [table + suffix for table in tables() for suffix in (".csv", ".parquet")]
    if PLAN.config["keep_projections"]:
        wanted += [
            f"{RESULTS}/projections/{PLAN.geometry_of(protocol)}/{noise}/seed{seed}.h5"
            for protocol, noise in ACQUISITIONS
            for seed in PLAN.seeds(noise)
        ]
    return wanted


include: "common_downloads.smk"
include: "common_study.smk"
include: "common_recordings.smk"
include: "common_proof.smk"
include: "common_pages.smk"
