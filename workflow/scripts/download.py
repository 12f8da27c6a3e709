"""Copy downloaded files to the paths in the configuration, after a check of their SHA-256 with the list of files."""

from collections.abc import Sequence

from virtual_phantom.study.job import job, log


def main(
    *,
    downloaded: Sequence[str],
    table: str,
    outputs: Sequence[str],
    sha256: Sequence[str],
    key: str,
) -> None:
    import shutil

    from virtual_phantom.io.files import replacing
    from virtual_phantom.io.published import check_listed

    for source, digest in zip(downloaded, sha256, strict=True):
        check_listed(source, digest, table, f"set {key} to a web folder that holds it")
    for source, path in zip(downloaded, outputs, strict=True):
        with replacing(path, checksum=False) as temporary:
            shutil.copyfile(source, temporary)
        log.info("%s", path)


if "snakemake" in globals():
    with job(snakemake):
        main(
            downloaded=snakemake.input.files,
            table=snakemake.input.table,
            outputs=snakemake.output,
            sha256=snakemake.params.sha256,
            key=snakemake.params.key,
        )
