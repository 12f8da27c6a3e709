# Published recordings, fetched where there is a network. docs/recordings.md says what they are.
storage published:
    provider="http",
    retries=1,


rule download_htc2022:
    """One sinogram of the Helsinki Tomography Challenge 2022 as a recording of projections."""
    input:
        lambda wildcards: published(
            f"{RESULTS}/downloads/htc2022_{wildcards.disc}",
            f"{PLAN.config['downloads']['htc2022']}/htc2022_{wildcards.disc}_full.mat",
        ),
    output:
        directory(f"{RESULTS}/downloads/htc2022_{{disc}}"),
    log:
        f"{RESULTS}/logs/download_htc2022/{{disc}}.log",
    wildcard_constraints:
        disc="solid_disc|t[a-d]",
    resources:
        mem_mb=1000,
        runtime=30,
    script:
        "../scripts/import_htc2022.py"
