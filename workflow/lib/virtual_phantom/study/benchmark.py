"""Suites of the blind validation for other programs, and the log of runs (targets `hide` and `score`)."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from ..base.errors import InputError
from ..base.settings import to_mapping
from ..proof.hiding import seal
from ..proof.scoring.registration import RESUMED, log_run
from .proof import Proof


@dataclass(frozen=True)
class Benchmark:
    """Suite of one configuration, and the verdicts of a program.

    Attributes
    ----------
    verdicts : str
        Folder with the verdicts of a program; empty: the verdicts of the diagnosis.
    """

    proof: Proof
    verdicts: str

    @classmethod
    def read(cls, proof: Proof) -> Benchmark:
        """Return the benchmark of a configuration; InputError if there is no folder of verdicts."""
        verdicts = proof.plan.study.verdicts
        if verdicts and not Path(verdicts).is_dir():
            raise InputError(f"verdicts: there is no folder {verdicts}; name a folder with the verdicts of a program")
        return cls(proof, verdicts)

    @property
    def program(self) -> str:
        """Name of the program: the name of the folder with its verdicts."""
        return Path(self.verdicts).name if self.verdicts else "diagnosis"

    def verdict_files(self) -> list[str]:
        """Return the verdict files of the program."""
        if not self.verdicts:
            return self.proof.all("verdict")
        return sorted(map(str, Path(self.verdicts).glob("[!.]*.json")))

    def given(self) -> dict:
        """Return what the diagnosis of each case is given, {case: {recording, object, model, effects}}."""
        return {
            case: {
                "recording": self.proof.files("proof_recording", case=case),
                "object": self.proof.object_files(case),
                "model": to_mapping(self.proof.model(case)),
                "effects": self.proof.tried_on(case),
            }
            for case in self.proof.cases
        }

    @property
    def registered(self) -> dict:
        """Return the settings that a registration states: `proof` without its real recordings, and of the diagnosis."""
        diagnosis = self.proof.plan.study.diagnosis
        stated = {key: value for key, value in to_mapping(self.proof.settings).items() if key != "recordings"}
        return stated | {"model_accuracy": diagnosis.model_accuracy, "matters": diagnosis.matters}

    @property
    def runs_file(self) -> str:
        """The log of runs. It is no output of a job, since jobs only append to it."""
        return str(Path(self.proof.files("registration")).with_name("runs.jsonl"))

    def log_start(self, rules: Collection[str]) -> None:
        """Add a resumed run to the log of runs if it has rules of the blind validation and was registered before.

        The job that registers a run logs its first start.
        """
        registered = Path(self.proof.files("registration"))
        ours = {rule for rule in rules if rule.startswith("proof_")} - {"proof_suite"}
        if registered.is_file() and ours and "proof_seal" not in ours:
            done = sum(Path(path).is_file() for path in self.proof.all("proof_diagnosis"))
            log_run(self.runs_file, RESUMED, seal.read(registered), done)

    def log_failure(self, snakemake_logs: Iterable[str]) -> None:
        """Add a failed run to the log of runs if it had a job of the registered blind validation."""
        registered = Path(self.proof.files("registration"))
        if registered.is_file() and any(
            "rule proof_" in Path(log).read_text(encoding="utf-8") for log in snakemake_logs
        ):
            log_run(self.runs_file, "failed", seal.read(registered))
