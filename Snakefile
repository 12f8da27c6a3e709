"""Virtual Phantom: simulate CT scans of a phantom, reconstruct them, and see which radiomics features to trust."""

from snakemake.utils import min_version

min_version("9.0")


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
include: "workflow/rules/download.smk"


localrules:
    all,


rule all:
    default_target: True
    input:
        targets(),
