"""Console output while jobs run: virtual_phantom.study.progress replaces Snakemake's block of lines per job.

A Snakefile has no documented access to the jobs of a run and to the command line options. All access to undocumented
attributes is in this file; tests/workflow/test_snakemake.py checks them for each version of Snakemake.
"""

import shutil
import sys

from snakemake.logging import logger

from virtual_phantom.study.progress.console import install_console
from virtual_phantom.study.progress.startup import DryRunHandler, wants_snakemake_output
from virtual_phantom.study.progress.time_left import Step


def steps():
    """List the jobs of this run, without rules such as `all` that only have inputs."""
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
    """Return the expected duration of each job, by its output file."""
    return context.expected_seconds(workflow.resource_settings.cores)


def show_progress():
    """Replace Snakemake's console output, unless the options ask for its own output or for no progress."""
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
    # With the default limit of 100 jobs per second, the scheduler looks for jobs every second for each finished job.
    # After a few dozen jobs, this occupies a core. One machine needs no limit, and no option switches it off: a
    # Snakefile cannot read the limit, and a longer period would delay the end of the run.
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None
    # Without sbatch, the plugin would retry, wait and end with the traceback of another command.
    elif (
        workflow.executor_plugin.name == "slurm" and shutil.which("sbatch") is None
    ):
        sys.exit(
            "Error: --executor slurm: sbatch was not found; run this on a submit host, or without --profile "
            "workflow/profiles/slurm"
        )
    context.benchmark.log_start(
        {job.rule.name for job in workflow.dag.needrun_jobs()}
    )
    show_progress()
