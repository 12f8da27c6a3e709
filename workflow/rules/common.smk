"""The one object that all rules share, `context`, and the wildcards."""

import json
import os
import sys
import tempfile
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
# own and find it by the variable. Without sys.path there is no way: Snakemake adds the folders of Snakefiles alone.
sys.path.insert(0, LIBRARY)
os.environ.update(
    PYTHONPATH=os.pathsep.join([LIBRARY, *filter(None, [os.environ.get("PYTHONPATH")])])
)
# Snakemake's scheduler and its jobs take these as they are, usable or not. Python takes a folder that it can write to.
os.environ.update(
    dict.fromkeys({"TMPDIR", "TMP"} & os.environ.keys(), tempfile.gettempdir())
)

from virtual_phantom.base.console import check_names, show_any_character
from virtual_phantom.base.errors import InputError, printed
from virtual_phantom.study.context import read_context

show_any_character()
try:
    check_names(
        os.getcwd(),
        *map(str, workflow.configfiles),
        json.dumps(config, ensure_ascii=False, default=str),
    )
    context = read_context(
        config, WORKFLOW, workflow.configfiles, here=workflow.is_main_process
    )
except InputError as error:
    sys.exit(printed(error))


wildcard_constraints:
    protocol="[A-Za-z0-9_]+",
    geometry="[A-Za-z0-9_]+",
    noise="[A-Za-z0-9_]+",
    seed="[0-9]{2}",
    recording="[A-Za-z0-9_]+",
    comparison="[A-Za-z0-9_]+",
    case="case_[0-9]+",
    phantom="|".join(context.proof.phantoms),
