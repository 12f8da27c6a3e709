"""User-written configurations: values that YAML changes are rejected by line, and null removes entries."""

import json
from pathlib import Path

import pytest
import yaml

from virtual_phantom.base import data
from virtual_phantom.base.errors import InputError
from virtual_phantom.cli import main
from virtual_phantom.config import read_config
from virtual_phantom.io.yaml_files import read_yaml
from virtual_phantom.phantom.layout import read_layout
from virtual_phantom.study.checks import preflight

ROOT = Path(__file__).resolve().parents[2]
PAPER_GROUPS = ROOT / "config" / "paper_groups.yaml"
BASE = "base: config/paper_groups.yaml\n"
QUOTES = "write the text in quotes"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A folder outside of the clone."""
    monkeypatch.chdir(tmp_path)


def checked(content, capsys):
    Path("my.yaml").write_bytes(content if isinstance(content, bytes) else content.encode())
    code = main.main(["check", "my.yaml"])
    return code, capsys.readouterr().err.splitlines()


@pytest.mark.parametrize(
    "content, line",
    [
        ("seed: 010\n", 'seed is 010, which YAML reads as 8; write 8 if it is a number, or "010" in quotes if'),
        ("seed: 12:30:00\n", "line 1: seed is 12:30:00, which YAML reads as 45000"),
        ("\nseed: 1_000\n", "line 2: seed is 1_000, which YAML reads as 1000"),
        ("results_dir: no\n", f"results_dir: is false to YAML, as no, off and false are without quotes; {QUOTES}"),
        ("results_dir: on\n", f"results_dir: is true to YAML, as yes, on and true are without quotes; {QUOTES}"),
        ("results_dir: 0x10\n", 'results_dir: is the number 16 to YAML; write it in quotes if it is a name: "16"'),
        ("results_dir: 1.0e+3\n", "results_dir: is the number 1000.0 to YAML; write it in quotes if it is a name"),
        ("results_dir: 2024-01-01\n", 'results_dir: is a date to YAML; write it in quotes: "2024-01-01"'),
        ("results_dir: ~\n", "results_dir: is null or empty to YAML; give text"),
        (
            "protocols: {off: {algorithm: fbp, projections: 90}}",
            "the key False in protocols is not text to YAML (as",
        ),
        ("protocols: {1: null, 01: null}", "protocols.01 occurs twice, in lines 1 and 1; YAML uses the last one"),
        ("seed: 1\nseed: 2\n", "my.yaml: seed occurs twice, in lines 1 and 2; YAML uses the last one: merge them"),
        ('{"seed": 1, "seed": 2}', "the key 'seed' occurs twice in one section; JSON uses the last one: merge them"),
        ("scan: {pitch: .inf}", "scan.pitch is inf; give a finite number"),
        ("grid:\n\tshape: [1, 1, 1]\n", "my.yaml, line 2: cannot be read as YAML (found character '\\t' that cannot"),
        ("results_dir: caf\xe9\n".encode("latin-1"), "my.yaml, line 1: is not text in UTF-8; save the file in UTF-8"),
        ("seed: 1\n".encode("utf-16"), "my.yaml: is text in UTF-16; save it in UTF-8"),
        ("", "my.yaml: is empty; give the path of a configuration"),
        ("# nothing\n", "my.yaml: is empty; give the path of a configuration"),
        ("- 1\n", "my.yaml: is not a mapping of keys to values but a list; give"),
        ("seed: 1\n---\nseed: 2\n", "my.yaml, line 2: cannot be read as YAML (but found another document)"),
        ("seed: !!python/name:os.system\n", "my.yaml, line 1: cannot be read as YAML (could not determine"),
    ],
)
def test_values_that_yaml_changes_are_one_line(content, line, capsys, monkeypatch):
    monkeypatch.setattr(preflight, "_scanned", lambda study: ())  # seconds for each seed
    code, lines = checked(content, capsys)
    assert code == 1 and sum(line in one for one in lines) == 1, lines


@pytest.mark.parametrize(
    "content, settings",
    [
        ("\ufeffseed: 3\n", {"seed": 3}),
        ("seed: 3\r\nresults_dir: 'no'\r\n", {"seed": 3, "results_dir": "no"}),
        ("results_dir: 1e3\n", {"results_dir": "1e3"}),  # text in YAML 1.1
        (json.dumps({"seed": 3}, indent="\t"), {"seed": 3}),
        ("protocols:\n  a: &a {projections: 90}\n  b: {<<: *a, group: 9}\n", {"protocols": None}),
        ("__use_yte__: true\nseed: ?3 + 4\n", {"seed": 7}),
    ],
)
def test_files_are_read_as_by_snakemake(content, settings):
    from snakemake.common.configfile import load_configfile

    Path("my.yaml").write_bytes(content.encode())
    lines, found = read_config.read_configs(["my.yaml"])
    assert not lines
    loaded = load_configfile("my.yaml")
    for key, value in settings.items():
        assert found[key] == value if value is not None else loaded[key].items() <= found[key].items(), key
        assert value is None or loaded[key] == value


@pytest.mark.parametrize("path", [".", "gone.yaml", "a\0b"])
def test_path_that_is_no_file_is_one_line(path, capsys):
    assert main.main(["check", path]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("Error: ") and "give the path of a configuration" in line


def test_exponentially_nested_aliases_are_rejected_at_once():
    layers = [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30)]
    Path("bomb.yaml").write_text("\n".join(["a0: &a0 [1]", *layers]))
    with pytest.raises(InputError, match="unfolds to too many items"):
        read_yaml("bomb.yaml", "")


@pytest.mark.parametrize("name", ["no", "1e+3_", "3.5", "2024-01-01", "null"])
def test_names_of_a_layout_are_text(name):
    from virtual_phantom.base.streams import Branch, branch
    from virtual_phantom.phantom.layout import parse_layout

    layout = read_layout()
    layout["rois"][0]["name"] = yaml.safe_load(name)
    if isinstance(layout["rois"][0]["name"], str):
        return
    with pytest.raises(InputError, match="to YAML; write the name in quotes"):
        parse_layout(layout, branch(1, Branch.PHANTOM))


# ---- null ----------------------------------------------------------------------------------------


def test_null_removes_an_entry_and_each_reference_gets_one_line(capsys):
    code, lines = checked(f"{BASE}protocols: {{sirt_300: null, fbp_450: null}}\n", capsys)
    assert (code, len(lines)) == (1, 5)
    for where, name in (
        ("analyses.optimal.fbp", "fbp_450"),
        ("analyses.noise_calibration.protocols", "sirt_300"),
        ("analyses.pca.sirt.protocols", "sirt_300"),
        ("analyses.pca.fbp.protocols", "fbp_450"),
    ):
        message = f"config: {where} names '{name}', which protocols.{name}: null removes; remove it or name another: "
        assert sum(message in line for line in lines) == 1, lines
    assert not [line for line in lines if "did you mean" in line]


@pytest.mark.parametrize(
    "content, line",
    [
        (
            "noise: {levels: {double: null}}",
            "analyses.noise_calibration.noise names 'double', which noise.levels.",
        ),
        (
            "scans: {wide: null}\nprotocols: {sirt_150: {scan: wide}}",
            "protocols.sirt_150.scan names 'wide', which scans.wide: null removes; remove it or name another: none",
        ),
        (
            "recordings: {a: null}\nanalyses: {stability: {recordings: [a]}}",
            "analyses.stability.recordings names 'a', which recordings.a: null removes",
        ),
        (
            "analyses: {comparison: {a: null}}\ndiagnosis: {comparisons: [a]}",
            "diagnosis.comparisons names 'a', which analyses.comparison.a: null removes",
        ),
        (
            "diagnosis: {recordings: {a: null, b: {physics_from: a}}}",
            "diagnosis.recordings.b.physics_from is 'a', which diagnosis.recordings.a: null removes; name another",
        ),
        (
            "diagnosis: {recordings: {a: null}}\nnoise: {model: physical}\nphysics: {from: a}",
            "physics.from names 'a', which diagnosis.recordings.a: null removes",
        ),
    ],
)
def test_null_is_named_in_every_section(content, line, capsys):
    code, lines = checked(BASE + content, capsys)
    assert code == 1 and sum(line in one for one in lines) == 1, lines


@pytest.mark.parametrize(
    "content, name, advice",
    [
        ("protocols: {sirt_30O: null}", "protocols.sirt_30O", "did you mean 'sirt_300'?"),
        ("noise: {levels: {Dose10: null}}", "noise.levels.Dose10", "did you mean 'dose10'?"),
        ("analyses: {optimall: null}", "analyses.optimall", "did you mean 'optimal'?"),
        ("recordings: {mine: null}", "recordings.mine", ""),
    ],
)
def test_null_that_removes_nothing_is_noted(content, name, advice, capsys, tmp_path):
    path = tmp_path / "my.yaml"
    path.write_text(BASE + content)
    assert main.main(["check", str(path)]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"Note: {path}: {name}: null removes nothing, as there is no such entry; ")
    assert line.endswith(advice)
    read_config.read_configs([path, PAPER_GROUPS])


@pytest.mark.parametrize("files", [("tiny",), ("printed_phantom",), ("recordings", "tiny"), ("stability_only",)])
def test_nulls_of_the_shipped_configurations_remove_something(files, capsys):
    read_config.read_configs([ROOT / "config" / f"{file}.yaml" for file in files])
    assert "null removes nothing" not in capsys.readouterr().err


@pytest.mark.parametrize("entry", ["{name: no, tissue_class: x}", "{name: a b, tissue_class: x}", "{name: ~}", "3"])
def test_rejected_entry_is_the_only_mistake(entry, capsys):
    rois = f"[{entry}, {{name: b, tissue_class: y, label: 3}}]"
    _, lines = checked(f"phantom: {{source: ct, ct: {{image: a.nii.gz, labels: b.nii.gz, rois: {rois}}}}}", capsys)
    assert not [line for line in lines if "are all of tissue_class" in line], lines


def test_removing_a_protocol_as_documented_works(capsys):
    text = (ROOT / "docs" / "how-to" / "protocols.md").read_text()
    (block,) = [part for part in text.split("```yaml\n")[1:] if "sirt_300: null" in part]
    assert checked(block.partition("```")[0], capsys) == (0, [])


# ---- without a clone ------------------------------------------------------------------------------


def test_package_has_the_study_of_the_papers_groups(monkeypatch, capsys):
    monkeypatch.setattr(read_config, "clone", lambda: None)
    Path("my.yaml").write_text(BASE)
    assert read_config.read_configs(["my.yaml"]) == ([], yaml.safe_load(PAPER_GROUPS.read_text()))
    assert main.main(["check", str(ROOT / "config" / "tiny.yaml")]) == 0
    assert capsys.readouterr().err == ""


def test_default_study_needs_a_clone(monkeypatch, capsys):
    monkeypatch.setattr(read_config, "clone", lambda: None)
    line = "config/config.yaml: not in this folder or in a clone; run in a clone, or set base: config/paper_groups.yaml"
    assert read_config.read_configs([]) == ([line], None)
    assert checked("seed: 3\n", capsys) == (1, [f"Error: {line}"])


def test_clone_of_an_installed_package_is_found(tmp_path, monkeypatch):
    """From pip's record of a local source (PEP 610)."""
    (tmp_path / "my clone" / "workflow").mkdir(parents=True)
    (tmp_path / "my clone" / "workflow" / "Snakefile").touch()

    class Installed:
        text = json.dumps({"url": (tmp_path / "my clone").as_uri(), "dir_info": {}})

        def read_text(self, name):
            return self.text if name == "direct_url.json" else None

    monkeypatch.setattr(data, "distribution", lambda name: Installed())
    monkeypatch.setattr(data, "_PACKAGE", tmp_path / "site" / "lib" / "python" / "virtual_phantom")
    assert data.clone.__wrapped__() == tmp_path / "my clone"
    monkeypatch.setattr(Installed, "text", json.dumps({"url": "https://example.org/a.git", "vcs_info": {}}))
    assert data.clone.__wrapped__() is None
