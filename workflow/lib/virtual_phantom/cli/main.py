"""The command `virtual-phantom`: write and check configurations, import recordings, export projections.

virtual-phantom init CT --labels FILE [--out my.yaml] [--size quick]   write a first configuration for your CT
virtual-phantom check CONFIG ...                                       list all errors of a configuration
virtual-phantom import FORMAT ...                                      convert scans to a recording folder
virtual-phantom export dicom-ct-pd PROJECTIONS.h5 FOLDER               write projections of a study as DICOM-CT-PD
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ..base.console import DEBUG, run_command
from ..base.errors import InputErrors
from ..recordings.importers import command as importers

SIZES = ("quick", "normal")


def main(words: Sequence[str] | None = None) -> int:
    """Run the command given by `words`, by default the command line, and return the exit code."""
    return run_command(_run, words)


def _run(words: Sequence[str]) -> int:
    if words[:1] == ["import"]:
        return importers.run(words[1:])
    arguments = _parser().parse_args(words)
    return {"init": _init, "check": _check, "export": _export}[arguments.command](arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="virtual-phantom",
        description=__doc__,
        epilog="Then run a study: snakemake --cores 2 --configfile my.yaml. Guides: docs/getting-started/index.md.\n"
        f"{DEBUG}, at any position, prints the traceback of an error.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    init = commands.add_parser("init", help="write a configuration for a CT and its segmented regions")
    init.add_argument("image", metavar="CT", help="folder with one DICOM series, or NIfTI file, in HU")
    init.add_argument("--labels", required=True, help="label map, DICOM SEG, RTSTRUCT, or folder of NIfTI masks")
    init.add_argument("--out", default="my.yaml", help="configuration to write; default my.yaml")
    quoting = "; put names with commas in double quotes, or repeat the option"
    init.add_argument(
        "--names",
        action="append",
        default=[],
        help="""names of labels: 5=liver,'"GTV, left"=gtv'; these are selected first""" + quoting,
    )
    init.add_argument(
        "--rois", action="append", default=[], help="""use only these labels or names: 5,'"GTV, left"'""" + quoting
    )
    init.add_argument(
        "--size", choices=SIZES, default="normal", help="quick: a trial of a few minutes; normal (default): for results"
    )
    init.add_argument("--not-checked", default="", help="names of the checks of the CT to skip, as in their messages")
    init.add_argument("--fill-gaps", action="store_true", help="interpolate missing slices between two drawn slices")
    init.add_argument("--force", action="store_true", help="overwrite existing files")
    check = commands.add_parser("check", help="list all errors of a configuration and its files")
    check.add_argument(
        "configs",
        metavar="CONFIG",
        nargs="+",
        help="configuration files, as after --configfile: later files override earlier ones",
    )
    export = commands.add_parser("export", help="write projections of a study in another format")
    export.add_argument("format", choices=("dicom-ct-pd",), help="one DICOM file per view")
    export.add_argument("source", metavar="PROJECTIONS", help="projections/.../*.h5 of a study")
    export.add_argument("folder", metavar="FOLDER", help="folder to write")
    commands.add_parser("import", help="convert another format to a recording folder", add_help=False)
    return parser


def _init(arguments: argparse.Namespace) -> int:
    from .init.command import initialize, summary_text  # imported here: takes seconds
    from .init.options import parse_list, parse_pairs

    names = parse_pairs(arguments.names)
    proposed = initialize(
        arguments.image,
        arguments.labels,
        arguments.out,
        names=names,
        rois=parse_list(arguments.rois, "--rois"),
        size=arguments.size,
        force=arguments.force,
        not_checked=parse_list([arguments.not_checked], "--not-checked"),
        fill_gaps=arguments.fill_gaps,
    )
    print(summary_text(proposed, arguments.out, names.values()))
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from ..config.read_config import read_configs
    from ..study.checks.preflight import problems  # imported here: takes seconds

    lines, settings = read_configs(arguments.configs)
    lines += problems(settings, scans=True) if settings is not None else []
    if lines:
        raise InputErrors(lines)
    print(f"{', '.join(arguments.configs)}: no errors found")
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from ..io.dicom_ct_pd import export_projections  # imported here: takes half a second

    print(f"{arguments.folder}: {export_projections(arguments.source, arguments.folder)} views")
    return 0
