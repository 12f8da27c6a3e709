"""The library on the path, and a quiet console from the first line on. It is included before anything else."""

import os
import sys
import tempfile
from pathlib import Path

from snakemake.logging import logger

# Where these rules lie, whoever's Snakefile uses them and wherever it runs.
RULES = workflow.current_basedir.get_path_or_uri(secret_free=True)
if not os.path.isdir(RULES):
    sys.exit(
        f"Error: {RULES}: the rules need the library beside them; clone the repository and name the workflow/Snakefile of "
        "the clone by its path"
    )
LIBRARY = str(Path(RULES).parent / "lib")
# The library beside the rules, whether one is installed or not: they change together. Scripts run in processes of their
# own and find it by the variable. Without sys.path there is no way: Snakemake adds the folders of Snakefiles alone.
sys.path.insert(0, LIBRARY)
os.environ.update(
    PYTHONPATH=os.pathsep.join([LIBRARY, *filter(None, [os.environ.get("PYTHONPATH")])])
)
# Snakemake's scheduler and its jobs take these as they are, usable or not. Python takes a folder that it can write to.
os.environ.update(
    dict.fromkeys({"TMPDIR", "TMP"} & os.environ.keys(), tempfile.gettempdir())
)

from virtual_phantom.base.console import show_any_character
from virtual_phantom.study.progress.startup import install_startup_handler

show_any_character()
if workflow.is_main_process:
    install_startup_handler(logger, workflow.output_settings)
