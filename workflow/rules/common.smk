"""Names that all rules share: `context`, `results`, `reported`, `code`, `resource`, `to_mapping`; and the wildcards."""

import json
import os
import sys
from functools import cache
from pathlib import Path

from virtual_phantom.base.console import check_names, collected_notes, printed_notes
from virtual_phantom.base.errors import InputError, printed
from virtual_phantom.base.settings import to_mapping
from virtual_phantom.config.dependencies import code_version, resource
from virtual_phantom.study.context import read_context

WORKFLOW = Path(workflow.current_basedir.get_path_or_uri(secret_free=True)).parent

try:
    check_names(
        os.getcwd(),
        *map(str, workflow.configfiles),
        json.dumps(config, ensure_ascii=False, default=str),
    )
    with printed_notes() if workflow.is_main_process else collected_notes():
        context = read_context(
            config, WORKFLOW, workflow.configfiles, here=workflow.is_main_process
        )
except InputError as error:
    sys.exit(printed(error))

# Thousands of jobs can share a script.
cached_version = cache(code_version)


def results(path):
    """Return the path of a file below results_dir; wildcards stay in braces."""
    return f"{context.results_folder}/{path}"


def reported(path):
    """Return an output below results_dir that Snakemake's report shows, with caption and section."""
    return report(results(path), **context.reported(path))


def named(protocols, wildcards):
    """Return the protocols of a job, with its wildcards filled in."""
    return [name.format(**wildcards) for name in protocols]


def code(script, effects=(), hooks=False):
    """Return a hash of the code of a script: a job runs again if the hash changes."""
    return cached_version(WORKFLOW / "scripts" / script, frozenset(effects), hooks)


wildcard_constraints:
    program="[^/]+",
    protocol="[A-Za-z0-9_]+",
    geometry="[A-Za-z0-9_]+",
    noise="[A-Za-z0-9_]+",
    seed="[0-9]{2}",
    recording="[A-Za-z0-9_]+",
    comparison="[A-Za-z0-9_]+",
    case="case_[0-9]+",
