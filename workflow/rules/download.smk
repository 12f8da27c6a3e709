# Published measurements, fetched where there is a network. docs/recordings.md and docs/your-own-phantom.md say what they
# are.
storage published:
    provider="http",
    retries=1,


rule download_htc2022:
    """One sinogram of the Helsinki Tomography Challenge 2022 as a recording of projections."""
    input:
        lambda wildcards: sinogram(wildcards.disc),
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


# Without the rule, files that are here are the user's: nothing asks the web for them, and nothing deletes them.
if ABSENT:

    rule download_abdomen_ct:
        """The CT and the regions of config/abdomen.yaml, or what is not here of them."""
        input:
            files=abdomen_ct,
            table=ABDOMEN_CT,
            code=code("download.py"),
        output:
            [file.path for file in ABSENT],
        log:
            f"{RESULTS}/logs/download_abdomen_ct.log",
        resources:
            mem_mb=1000,
            runtime=30,
        params:
            sha256=[file.sha256 for file in ABSENT],
            key="downloads.abdomen_ct",
        script:
            "../scripts/download.py"
