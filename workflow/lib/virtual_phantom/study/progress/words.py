"""What Snakemake 9 and Python say in words alone, without an event or a field that would tell.

Where they say it otherwise, lines are shown that say no more than others, and no failure is lost.
tests/workflow/test_snakemake.py fails then.
"""

import re

# Beginnings of messages that tell users nothing.
NOISE = ("Select jobs to execute...", "Removing temporary output ", "Exiting because a job execution failed.")
# A run has ended, and not all is done.
INCOMPLETE = "At least one job did not complete"
# Which job ended well without its files: the exception is sent, and no failure of a job.
FILES_MISSING = re.compile(r"Job (\d+)\s+completed successfully, but some output files are missing")
# Python's, of a script that said itself what is wrong.
EXITED_WITH_1 = "returned non-zero exit status 1."
