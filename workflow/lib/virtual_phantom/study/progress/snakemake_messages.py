"""Messages of Snakemake 9 and Python that the progress console hides or replaces.

Snakemake does not mark them by an event, so they are recognized by their text. If another version changes a text,
unneeded lines appear, but no error message is lost. tests/workflow/test_snakemake.py compares the texts with the
installed Snakemake.
"""

import re

# Beginnings of messages that are never shown.
HIDDEN = (
    "Select jobs to execute...",
    "Removing temporary output ",
    "Exiting because a job execution failed.",
    "Shutting down, this might take some time.",
    "Elapsed time: ",
)
# Beginnings of messages that are not shown before the first job.
HIDDEN_AT_STARTUP = (
    "Config file ",
    "Assuming unrestricted shared filesystem usage.",
    "Building DAG of jobs...",
    "Using shell: ",
    "Group jobs: inactive (local execution)",
)
# Messages of a dry run that `startup.DryRunHandler` replaces.
DRY_RUN = (
    "Reasons:",
    "Some jobs were triggered by provenance",
    "Rules with provenance",
    "Would remove temporary output ",
)
# Beginning of the last message of a dry run.
DRY_RUN_ENDS = "This was a dry-run"
# A run ended before all jobs were done.
INCOMPLETE = "At least one job did not complete"
# A job ended without an error but without its files. Snakemake then reports an exception for missing output files, but
# not that the job failed.
FILES_MISSING = re.compile(r"Job (\d+)\s+completed successfully, but some output files are missing")
# How a script ended: the name of a signal or the exit status.
ENDED_BY = re.compile(r"died with <Signals\.(SIG\w+): \d+>|returned non-zero exit status (\d+)")
