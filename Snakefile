"""Entry point for `snakemake` in this folder. The workflow is in workflow/Snakefile."""


include: "workflow/Snakefile"


rule default:
    """The same as `all`, since a file that is included sets no default target."""
    default_target: True
    input:
        rules.all.input,
    localrule: True
