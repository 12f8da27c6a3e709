"""Score the verdicts of a program on a suite of the blind validation."""

from collections.abc import Sequence

from virtual_phantom.io.documents import PROGRAM_SCORE, write_document
from virtual_phantom.io.files import write_text
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.scoring.collect import collect_verdicts
from virtual_phantom.proof.scoring.headline import headline
from virtual_phantom.proof.scoring.record import result_table, summary
from virtual_phantom.proof.scoring.verdicts import digests, read_verdicts
from virtual_phantom.study.job import job


def main(
    *,
    sealed: Sequence[str],
    seals: str,
    verdicts: Sequence[str],
    hashes_file: str,
    score_file: str,
    table_file: str,
    program: str,
) -> None:
    documents = read_verdicts(verdicts, seal.read(seals))
    seal.write(digests(verdicts), hashes_file)  # before the seals are opened
    found = {"program": program} | headline(collect_verdicts(sealed, seals, documents))
    write_document(found, score_file, PROGRAM_SCORE)
    table = "\n".join(result_table(**summary(found))) + "\n"
    write_text(table, table_file)
    print(table)


if "snakemake" in globals():
    with job(snakemake):
        main(
            sealed=snakemake.input.sealed,
            seals=snakemake.input.seals,
            verdicts=snakemake.input.verdicts,
            hashes_file=snakemake.output.hashes,
            score_file=snakemake.output.score,
            table_file=snakemake.output.table,
            program=snakemake.wildcards.program,
        )
