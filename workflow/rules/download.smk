# Download of published measurements, described in docs/how-to/recordings.md and docs/how-to/phantoms.md.
from virtual_phantom.study.context import or_exit


storage published:
    provider="http",
    retries=1,


rule download_htc2022:
    """Download one sinogram of the Helsinki Tomography Challenge 2022 as a recording of projections."""
    input:
        or_exit(
            lambda wildcards: storage.published(
                context.recordings.sinogram_online(wildcards.disc)
            )
        ),
    output:
        directory(results("downloads/htc2022_{disc}")),
    log:
        results("logs/download_htc2022/{disc}.log"),
    wildcard_constraints:
        disc="solid_disc|t[a-d]",
    resources:
        mem_mb=1000,
        runtime=30,
    script:
        "../scripts/import_htc2022.py"


# Files that exist belong to the user: without this rule, Snakemake neither downloads nor deletes them.
if context.phantom.absent:

    rule download_abdomen_ct:
        """Download the missing files of the CT and the regions of config/abdomen.yaml."""
        input:
            files=or_exit(
                lambda wildcards: [
                    storage.published(url) for url in context.phantom.absent_online()
                ]
            ),
            table=context.phantom.table,
        output:
            [file.path for file in context.phantom.absent],
        log:
            results("logs/download_abdomen_ct.log"),
        resources:
            mem_mb=1000,
            runtime=30,
        params:
            sha256=[file.sha256 for file in context.phantom.absent],
            key="downloads.abdomen_ct",
            code=code("download.py"),
        script:
            "../scripts/download.py"
