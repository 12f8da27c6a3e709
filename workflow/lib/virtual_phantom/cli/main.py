"""The command `virtual-phantom`: a first configuration, a check of one, import of recordings, export of projections.

virtual-phantom init CT --labels FILE [--out my.yaml] [--size quick]   propose a configuration for your CT
virtual-phantom check CONFIG ...                                       say all that is wrong with a configuration
virtual-phantom import FORMAT ...                                      make a recording folder
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
    """Do what the command line asks for, or these words of one; returns the exit code."""
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
        epilog=f"{DEBUG}, anywhere on the line, prints the traceback of an error.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    init = commands.add_parser("init", help="propose a configuration for a CT and the regions drawn on it")
    init.add_argument("image", metavar="CT", help="folder of one DICOM series, or NIfTI file; HU")
    init.add_argument("--labels", required=True, help="label map, DICOM SEG, RTSTRUCT, or folder of NIfTI masks")
    init.add_argument("--out", default="my.yaml", help="configuration to write; default my.yaml")
    quoting = "; a name with a comma in double quotes, or the option several times"
    init.add_argument(
        "--names",
        action="append",
        default=[],
        help="""names of labels: 5=liver,'"GTV, left"=gtv'; they go before larger ones""" + quoting,
    )
    init.add_argument(
        "--rois", action="append", default=[], help="""take these labels or names alone: 5,'"GTV, left"'""" + quoting
    )
    init.add_argument("--size", choices=SIZES, default="normal", help="quick: a trial of minutes; default normal")
    init.add_argument("--not-checked", default="", help="checks of the CT to leave out, as named in their lines")
    init.add_argument("--fill-gaps", action="store_true", help="interpolate slices that are not drawn between two")
    init.add_argument("--force", action="store_true", help="overwrite files that are there")
    check = commands.add_parser("check", help="say all that is wrong with a configuration and its files")
    check.add_argument(
        "configs", metavar="CONFIG", nargs="+", help="as after --configfile: a later one changes keys of those before"
    )
    export = commands.add_parser("export", help="write projections of a study in another format")
    export.add_argument("format", choices=("dicom-ct-pd",), help="one DICOM file per view")
    export.add_argument("source", metavar="PROJECTIONS", help="projections/.../*.h5 of a study")
    export.add_argument("folder", metavar="FOLDER", help="folder to write")
    commands.add_parser("import", help="make a recording folder from another format", add_help=False)
    return parser


def _init(arguments: argparse.Namespace) -> int:
    from .init.command import initialise, told  # seconds, for those who use it
    from .init.options import listed, paired

    proposed = initialise(
        arguments.image,
        arguments.labels,
        arguments.out,
        names=paired(arguments.names),
        rois=listed(arguments.rois, "--rois"),
        size=arguments.size,
        force=arguments.force,
        not_checked=listed([arguments.not_checked], "--not-checked"),
        fill_gaps=arguments.fill_gaps,
    )
    print(told(proposed, arguments.out))
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from ..config.read_config import read_configs
    from ..study.checks.preflight import problems  # seconds, for those who use it

    lines, settings = read_configs(arguments.configs)
    lines += problems(settings, scans=True) if settings is not None else []
    if lines:
        raise InputErrors(lines)
    print(f"{', '.join(arguments.configs)}: nothing wrong was found")
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from ..io.dicom_ct_pd import export_projections  # half a second, for those who use it

    print(f"{arguments.folder}: {export_projections(arguments.source, arguments.folder)} views")
    return 0
