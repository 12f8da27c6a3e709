"""What Snakemake 9 and Python say in words alone, without an event or a field that would tell.

Where they say it otherwise, lines are shown that say no more than others, and no failure is lost.
tests/workflow/test_snakemake.py fails then.
"""

import re

# Beginnings of messages that tell users nothing.
NOISE = (
    "Select jobs to execute...",
    "Removing temporary output ",
    "Exiting because a job execution failed.",
    "Shutting down, this might take some time.",
    "Elapsed time: ",
)
# The same of messages before the first job.
BEFORE = (
    "Config file ",
    "Assuming unrestricted shared filesystem usage.",
    "Building DAG of jobs...",
    "Using shell: ",
    "Group jobs: inactive (local execution)",
)
# Of a dry run: what its summary says in a shorter form, and the message that ends it.
DRY_RUN = (
    "Reasons:",
    "Some jobs were triggered by provenance",
    "Rules with provenance",
    "Would remove temporary output ",
)
DRY_RUN_ENDS = "This was a dry-run"
# A run has ended, and not all is done.
INCOMPLETE = "At least one job did not complete"
# Which job ended well without its files: the exception is sent, and no failure of a job.
FILES_MISSING = re.compile(r"Job (\d+)\s+completed successfully, but some output files are missing")
# How a script ended: the name of a signal, or a number.
ENDED_BY = re.compile(r"died with <Signals\.(SIG\w+): \d+>|returned non-zero exit status (\d+)")
