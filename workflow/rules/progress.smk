"""What is said while jobs run: virtual_phantom.progress in place of a block of lines for each job."""

from virtual_phantom.progress.console import take_over
from virtual_phantom.progress.time_left import Step


def steps():
    """The jobs of this run."""
    return [
        Step(job.jobid, job.rule.name, tuple(map(str, job.output)), job.threads)
        for job in workflow.dag.needrun_jobs()
    ]


def expected_seconds():
    """Seconds that each file of the study takes one core, of jobs with a measured rate."""
    # It takes a second to import what is behind these, which a short run should not wait for.
    from virtual_phantom.costs.jobs import study_jobs
    from virtual_phantom.costs.rates import seconds
    from virtual_phantom.costs.table import roi_count

    try:
        rois = roi_count(PLAN.config["phantom"])
    except InputError as error:
        workflow.logger_manager.logger.warning(
            f"No time left is estimated from rates: {error}"
        )
        return {}
    return {
        f"{RESULTS}/{file}": seconds(job, RATES)
        for job in study_jobs(PLAN, ENGINE, rois)
        if seconds(job, RATES) is not None
        for file in job.outputs
    }


def say_less():
    """Once a run begins. Who asks for more words, or for fewer, gets Snakemake's."""
    settings = workflow.output_settings
    asked = {what.name for what in settings.quiet or ()} - {"HOST"}  # the profile's
    if not settings.verbose and not asked:
        take_over(
            workflow.logger_manager.logger,
            steps(),
            workflow.cores if workflow.local_exec else None,
            expected_seconds,
            f"{RESULTS}/logs",
        )
