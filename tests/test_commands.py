"""Every documented command has a test, and its files, options and targets exist."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from commands import commands

ROOT = Path(__file__).resolve().parents[1]
FOUND = commands(ROOT)
TABLE = yaml.safe_load((ROOT / "tests" / "commands.yaml").read_text(encoding="utf-8"))


def test_commands_of_a_page_are_found(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text(
        "Say `snakemake -n\n--lint` or `snakemake`.\n\n"
        "```\nmake test  # all\npython a.py \\\n    --b\nsaid by it\n```\n\n"
        "```yaml\nmake: no\n```\n\n<!-- run -->\n```\nmake this\n```\n"
    )
    found = commands(tmp_path)
    assert found == {one: ["README.md"] for one in ("make test", "python a.py --b", "snakemake -n --lint")}


def test_every_command_is_run_by_a_test_or_by_hand():
    listed = [*TABLE["tests"], *TABLE["by_hand"]]
    assert len(FOUND) > 50 and len(set(listed)) == len(listed)
    without = {command: pages for command, pages in FOUND.items() if command not in listed}
    assert not without, "say in tests/commands.yaml what runs these"
    assert not set(listed) - set(FOUND), "no page names these any more; take them out of tests/commands.yaml"


@pytest.mark.parametrize("test", sorted({test for tests in TABLE["tests"].values() for test in tests}))
def test_tests_of_commands_exist(test):
    file, name = test.split("::")
    assert re.search(rf"^ *def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)


def words(program):
    """Arguments of every command that begins with a program, for each part of a line with several."""
    parts = [part for command in FOUND for part in re.split(r" && ", command)]
    return [shlex.split(part.replace("...", "")) for part in parts if re.match(rf"(\S*/)?{program}(\s|$)", part)]


def test_make_has_the_targets():
    expected = {word for line in words("make") for word in line[1:] if "=" not in word}
    assert {"setup", "test", "docs"} <= expected
    make = shutil.which("make")
    process = subprocess.run([make, "-n", *sorted(expected)], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stderr


def test_scripts_have_the_options():
    scripts = [line[1:] for line in words("python") if line[1].endswith(".py")]
    scenarios = [line[4:] for line in words("python") if line[1:4] == ["-m", "benchmarks", "run"]]
    assert len(scripts) > 10 and len(scenarios) > 35
    scripts += [[f"benchmarks/{name}.py", *arguments] for name, *arguments in scenarios]
    importer = words("virtual-phantom-import")
    assert len(importer) > 3
    scripts += [["workflow/lib/virtual_phantom/recordings/importers/command.py", *line[1:]] for line in importer]
    for script, *arguments in scripts:
        text = (ROOT / script).read_text(encoding="utf-8")
        for function, module in (("simulator_scans.add_draws", "simulator_scans"), ("add_realizations", "__init__")):
            if f"{function}(" in text:
                text += (ROOT / "benchmarks" / "common" / f"{module}.py").read_text(encoding="utf-8")
        for option in (word for word in arguments if word.startswith("--")):
            assert f'"{option}"' in text, f"{script} has no {option}"


def test_named_files_exist():
    """Only files of the project: users' files are called my.yaml."""
    named = [
        (after, line[line.index(after) + 1])
        for after in ("--configfile", "-r", "--requirement", "--profile")
        for line in words("(?:snakemake|pip|pip-audit)")
        if after in line
    ]
    assert len(named) > 10
    assert not [name for _, name in named if name != "my.yaml" and not (ROOT / name).exists()]
