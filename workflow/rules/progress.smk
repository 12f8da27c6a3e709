"""What is said while jobs run: virtual_phantom.study.progress in place of a block of lines for each job.

Snakemake documents neither what a run will do nor its options to a Snakefile. All that is taken of them stands here, and
tests/workflow/test_snakemake.py says what another version has no more.
"""

import shutil
import sys

from snakemake.logging import logger

from virtual_phantom.study.progress.console import install_console
from virtual_phantom.study.progress.startup import DryRunHandler, wants_snakemake_output
from virtual_phantom.study.progress.time_left import Step


def steps():
    """The jobs of this run. What only lists files to be made, as `all`, is none."""
    jobs = [job for job in workflow.dag.needrun_jobs() if not job.is_norun]
    numbers = {job: job.jobid for job in jobs}
    return [
        Step(
            job.jobid,
            job.rule.name,
            tuple(map(str, job.output)),
            job.threads,
            tuple(
                numbers[other]
                for other in workflow.dag.dependencies.get(job, ())
                if other in numbers
            ),
            next(map(str, job.log), None),
        )
        for job in jobs
    ]


def expected():
    """What each job is expected to take, by the file that it makes."""
    return context.expected_seconds(workflow.resource_settings.cores)


def say_less():
    """Once a run begins. Who asks for more words, or for none of how far it is, gets Snakemake's."""
    settings = workflow.output_settings
    if not wants_snakemake_output(settings):
        install_console(
            logger,
            steps(),
            workflow.cores if workflow.local_exec else None,
            expected,
            results("logs"),
            workflow.execution_settings.keep_going,
            context.results_folder,
            settings.show_failed_logs,
        )


for handler in logger.handlers:
    if isinstance(handler, DryRunHandler):
        handler.expected, handler.folder = expected, context.results_folder
        handler.cores = lambda: workflow.resource_settings.cores


onstart:
    # The default limit of 100 jobs per second makes the scheduler look for jobs once more in every second for each job
    # that has finished: after some dozens it takes a core of its own. On one machine nothing has to be limited. There is
    # no setting for that: a Snakefile cannot see the limit, and a longer span would keep Snakemake waiting at the end.
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None
    # Without it the plugin would retry, wait, and end in a traceback of another command.
    elif (
        workflow.executor_plugin.name == "slurm" and shutil.which("sbatch") is None
    ):
        sys.exit(
            "Error: --executor slurm: there is no sbatch here; run this where jobs can be submitted, or leave --profile "
            "workflow/profiles/slurm out"
        )
    say_less()
