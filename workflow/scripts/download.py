"""Published files, put where a configuration names them if they are those that are listed."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    import shutil

    from virtual_phantom.io.files import replacing
    from virtual_phantom.io.published import check_listed

    params = snakemake.params
    for source, digest in zip(snakemake.input.files, params.sha256, strict=True):
        check_listed(source, digest, snakemake.input.table, f"set {params.key} to a web folder that holds it")
    for source, path in zip(snakemake.input.files, snakemake.output, strict=True):
        with replacing(path, checksum=False) as temporary:
            shutil.copyfile(source, temporary)
        log.info("%s", path)
