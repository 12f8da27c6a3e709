"""Write the verdict document of each diagnosis of the blind validation, with the hashes of the files behind it.

The hashes show later that no diagnosis was changed after the hidden effects were known.
"""

from collections.abc import Sequence
from pathlib import Path

from virtual_phantom.io.documents import VERDICT, write_document
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.scoring.verdicts import verdict_document
from virtual_phantom.study.job import job


def main(*, diagnoses: Sequence[str], others: Sequence[str], outputs: Sequence[str]) -> None:
    tables = {Path(path).parent: path for path in others}
    for diagnosis, path in zip(diagnoses, outputs, strict=True):
        files = seal.files_of(diagnosis, tables.get(Path(diagnosis).parent))
        write_document(verdict_document(seal.read(diagnosis)) | {"files": files}, path, VERDICT)


if "snakemake" in globals():
    with job(snakemake):
        main(
            diagnoses=snakemake.input.diagnoses,
            others=snakemake.input.others,
            outputs=snakemake.output,
        )
