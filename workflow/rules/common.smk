"""The one object that all rules share, `context`, and the wildcards."""

import json
import os
import sys
from pathlib import Path

from virtual_phantom.base.console import check_names, printed_notes
from virtual_phantom.base.errors import InputError, printed
from virtual_phantom.study.context import read_context

WORKFLOW = Path(workflow.current_basedir.get_path_or_uri(secret_free=True)).parent

try:
    check_names(
        os.getcwd(),
        *map(str, workflow.configfiles),
        json.dumps(config, ensure_ascii=False, default=str),
    )
    with printed_notes():
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
