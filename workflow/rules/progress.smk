"""What is said while jobs run: virtual_phantom.study.progress in place of a block of lines for each job."""

from virtual_phantom.study.costs.jobs import study_jobs
from virtual_phantom.study.costs.rates import seconds
from virtual_phantom.study.progress.console import take_over
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
        )
        for job in jobs
    ]


def expected_seconds():
    """Seconds that each file of the study takes one core, of jobs with a measured rate."""
    # Regions count for what is written only.
    return {
        f"{RESULTS}/{file}": takes
        for job in study_jobs(PLAN, ENGINE, rois=0)
        if (takes := seconds(job, RATES)) is not None
        for file in job.outputs
    }


def say_less():
    """Once a run begins. Who asks for more words, or for none of how far it is, gets Snakemake's."""
    settings = workflow.output_settings
    asked = {what.name for what in settings.quiet or ()}
    # The profile's, and a line for each job, of which we have none.
    asked -= {"HOST", "RULES"}
    if not settings.verbose and not asked:
        take_over(
            workflow.logger_manager.logger,
            steps(),
            workflow.cores if workflow.local_exec else None,
            expected_seconds,
            f"{RESULTS}/logs",
            workflow.execution_settings.keep_going,
        )
