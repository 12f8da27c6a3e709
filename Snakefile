"""Virtual Phantom: simulate CT scans of a phantom, reconstruct them, and see which radiomics features to trust."""

import shutil

from snakemake.utils import min_version

min_version("9.27")


configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/phantom.smk"
include: "workflow/rules/simulate.smk"
include: "workflow/rules/reconstruct.smk"
include: "workflow/rules/extract.smk"
include: "workflow/rules/stats.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/recordings.smk"
include: "workflow/rules/compare.smk"
include: "workflow/rules/diagnose_features.smk"
include: "workflow/rules/diagnose.smk"
include: "workflow/rules/proof.smk"
include: "workflow/rules/dicom.smk"
include: "workflow/rules/pages.smk"
include: "workflow/rules/download.smk"
include: "workflow/rules/plan.smk"
include: "workflow/rules/progress.smk"


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
            "profiles/slurm out"
        )
    say_less()


localrules:
    all,


rule all:
    default_target: True
    input:
        targets(),
