"""Build a phantom of the proof: what is scanned (fine), and what the diagnosis is told of it."""

from pathlib import Path

from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.phantom import write_phantom
from virtual_phantom.proof.conceal.objects import OBJECTS
from virtual_phantom.proof.conceal.phantoms import build
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    one = OBJECTS[snakemake.wildcards.phantom]
    seed = branch(params.seed, Branch.PROOF_PHANTOM)
    phantom = build(one, snakemake.input.layout, params.scan["columns"], params.scan["rows"], seed)
    write_phantom(phantom, Path(snakemake.output.image).parent)
    log.info("scanned on %s, known on %s", phantom.fine.grid, phantom.image.grid)
