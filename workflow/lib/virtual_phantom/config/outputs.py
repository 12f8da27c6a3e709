"""All files that the workflow makes, for targets, the plan, the report and the reference page.

The table is `outputs.csv` of the package's resources; a row has the attributes of `Output`, and empty cells are None.
The rules repeat the paths, so that readers of a rule file see them; tests/workflow/test_outputs.py compares both. Logs
and benchmarks are not in the table: they lie in `logs` and are named after their jobs.

A row adds the file to the page of output files (docs/generators/output_files.py) and gives its job a cost in a plan.
With a section, Snakemake's report shows the file; its rule then needs `reported(path)`, and its caption must exist. The
study's report shows the figures and tables of `study.analyses`, with tables in the order of the rows.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import PurePosixPath

from ..base.data import RESOURCES

WILDCARD = re.compile(r"\{(\w+)\}")
PICTURES = (".png", ".pdf")  # formats of a figure
PCA = ("sirt", "fbp", "multicentre")  # possible entries of analyses.pca


@dataclass(frozen=True)
class Output:
    """One kind of file or folder.

    Attributes
    ----------
    name : str
        Name in the code.
    rule : str
        Rule that makes it, without the number that distinguishes rules of one kind.
    pattern : str
        Path relative to results_dir, with wildcards in braces.
    description : str
        Content of the file.
    title : str or None
        Title in reports; None: the name of the file. Tables without a title are the last in the study's report.
    section : str or None
        Section of Snakemake's report, and of the study's report for a figure; None: not shown.
    caption : str or None
        Caption file in workflow/report, without suffix; None: named after the output file.
    suffixes : tuple of str
        Suffixes of an output with several files, separated by spaces in the table: ".png .pdf" for a figure.
    stage : str or None
        Key under `seconds` in resources/rates.yaml with the run time of the rule's jobs ("tables" for most tables). A
        suffix may follow, depending on the configuration (study.costs.jobs.Sizes). None: not part of the plan.
    counted : str or None
        Key under `bytes` in resources/rates.yaml with the size of the files that a job writes; None: not counted.
    """

    name: str
    rule: str
    pattern: str
    description: str
    title: str | None
    section: str | None
    caption: str | None
    suffixes: tuple[str, ...]
    stage: str | None
    counted: str | None

    def paths(self, **known: str) -> tuple[str, ...]:
        """Return the paths relative to results_dir. Unknown wildcards stay in braces."""
        return tuple(filled(self.pattern, **known) + suffix for suffix in self.suffixes)

    def caption_file(self, **known: str) -> str:
        """Return the name of the caption file in workflow/report."""
        return f"{self.caption or PurePosixPath(filled(self.pattern, **known)).stem}.rst"


def filled(pattern: str, **known: str) -> str:
    """Return a pattern with the known wildcards replaced."""
    return WILDCARD.sub(lambda match: str(known.get(match[1], match[0])), pattern)


def _read() -> tuple[Output, ...]:
    outputs = []
    for row in csv.DictReader((RESOURCES / "outputs.csv").read_text(encoding="utf-8").splitlines()):
        suffixes = tuple(row.pop("suffixes").split()) or ("",)
        outputs.append(Output(**{key: cell or None for key, cell in row.items()}, suffixes=suffixes))
    return tuple(outputs)


OUTPUTS = _read()  # outputs with a title are in the order of the study's report
BY_NAME = {output.name: output for output in OUTPUTS}


def by_path(path: str) -> Output:
    """Return the row of the table for a path.

    Parameters
    ----------
    path : str
        Path below results_dir, with wildcards in braces.

    Raises
    ------
    KeyError
        If no row has this path.
    """
    for output in OUTPUTS:
        if path in output.paths():
            return output
    raise KeyError(f"{path}: no row of the table of outputs")


@dataclass(frozen=True)
class Files:
    """Paths of the files of one study, with unknown wildcards in braces as in Snakemake rules.

    Attributes
    ----------
    results : str
        results_dir of the study.
    """

    results: str

    def __call__(self, name: str, suffix: str = "", **known: str) -> str:
        """Return the path of an output by its name in the table, with the suffix if it has several files.

        Parameters
        ----------
        **known : str
            Wildcards.

        Raises
        ------
        KeyError
            For an unknown output or suffix.
        """
        output = BY_NAME[name]
        if suffix not in output.suffixes:
            raise KeyError(f"{name}: '{suffix}' is none of {output.suffixes}")
        return f"{self.results}/{filled(output.pattern, **known)}{suffix}"

    def benchmark(self, job: str) -> str:
        """Return the file with Snakemake's benchmark of a job."""
        return f"{self.results}/logs/{job}.benchmark.tsv"
