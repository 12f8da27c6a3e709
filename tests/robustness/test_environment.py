"""Home folder, Matplotlib's settings, encodings and the current folder: each works or gives one line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import virtual_phantom as vp
from virtual_phantom.base.cache_folders import user_cache
from virtual_phantom.base.console import run_command
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.home import expand_home
from virtual_phantom.config.config import inspect_config

LIBRARY = Path(vp.__file__).resolve().parents[1]
DRAW = """
from virtual_phantom.figures.style import ShownFigure
import matplotlib, io
figure = ShownFigure()
figure.subplots().plot([1, 2])
assert figure._repr_png_().startswith(b"\\x89PNG")
print(matplotlib.get_configdir())
"""


def run(program, cwd, **variables):
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("MPL", "XDG"))}
    environment = clean | {"PYTHONPATH": str(LIBRARY)} | variables
    words = [sys.executable, "-c", program]
    return subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def home(tmp_path, monkeypatch):
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    return str(folder)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("~", "{home}"),
        ("~/a b", "{home}/a b"),
        ("~no_such_user/a", "~no_such_user/a"),
        ("~5 mm", "~5 mm"),
        ("./~/a", "./~/a"),
        ("a/~", "a/~"),
        (Path("~/a"), Path("{home}/a")),
        ({"x": ["~/a", 3, None], "~/key": ("~/b",)}, {"x": ["{home}/a", 3, None], "~/key": ("{home}/b",)}),
    ],
)
def test_tilde_is_the_home_folder(home, written, meant):
    def at_home(value):
        if isinstance(value, dict):
            return {key: at_home(one) for key, one in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(map(at_home, value))
        return type(value)(str(value).format(home=home)) if isinstance(value, str | Path) else value

    assert expand_home(written) == at_home(meant)


@pytest.mark.parametrize("user", ["root", pytest.param("nobody", id="another")])
def test_tilde_with_a_user_is_the_users_folder(user):
    pwd = pytest.importorskip("pwd")
    try:
        folder = pwd.getpwnam(user).pw_dir
    except KeyError:
        pytest.skip(f"there is no user {user}")
    assert expand_home(f"~{user}/a") == os.path.join(folder, "a")


def test_all_paths_of_a_configuration_may_begin_with_a_tilde(home):
    ct = {"image": "~/ct", "labels": "~/l.nii", "rois": [{"name": "a", "tissue_class": "liver", "file": "~/r.nii"}]}
    settings = {
        "results_dir": "~/results",
        "phantom": {"source": "ct", "ct": ct},
        "recordings": {"mine": "~/recording"},
        "features": {"parameters": "~/p.yaml"},
        "public_scans": {"sources": {"scans": "~/scans"}},
    }
    _, config = inspect_config(settings)
    found = [config["results_dir"], config["recordings"]["mine"], config["features"]["parameters"]]
    found += [config["phantom"]["ct"]["image"], config["phantom"]["ct"]["labels"]]
    found += [config["phantom"]["ct"]["rois"][0]["file"]]
    ends = ("results", "recording", "p.yaml", "ct", "l.nii", "r.nii")
    assert found == [f"{home}/{end}" for end in ends]
    assert settings["results_dir"] == "~/results"


def test_command_line_and_function_arguments_may_begin_with_a_tilde(home):
    words = []
    run_command(lambda clean: words.extend(clean) or 0, ["init", "~/ct", "--out=~/a=b.yaml", "--names", "5=~", "~x"])
    assert words == ["init", f"{home}/ct", f"--out={home}/a=b.yaml", "--names", "5=~", "~x"]
    with pytest.raises(InputError, match=f"^{home}/no.nii"):
        vp.read_phantom("~/no.nii", [{"name": "a", "tissue_class": "liver", "file": "~/a.nii"}])
    with pytest.raises(InputError, match=f"^{home}/layout.yaml"):
        vp.draw_phantom(layout_file="~/layout.yaml")
    with pytest.raises(InputError, match=f"^{home}/scan"):
        vp.diagnose(Path("~/scan"), disc=(1, "PMMA"))


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"results_dir": "~/x"}, "results_dir: ~/x"),
        ({"recordings": {"a": "~"}}, "recordings.a: ~"),
        ({"phantom": {"ct": {"rois": [{"file": "~/x"}]}}}, "phantom.ct.rois.0.file: ~/x"),
    ],
)
def test_tilde_without_a_home_folder_is_one_line(monkeypatch, settings, key):
    monkeypatch.setenv("HOME", "")  # as in some containers; nobody wants a path below /
    line = f"{key}: no home folder is known for ~; set HOME or write the whole path"
    assert inspect_config(settings) == ([line], {})
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert user_cache() is None


@pytest.mark.parametrize(
    "variables",
    [
        {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "MPLCONFIGDIR": "{file}/x"},
        {"MPLBACKEND": "nonsense", "HOME": ""},
        {"MATPLOTLIBRC": "{file}", "MPLCONFIGDIR": "~/x"},
    ],
)
def test_figures_do_not_depend_on_matplotlib_settings(tmp_path, variables):
    file, temporary = tmp_path / "matplotlibrc", tmp_path / "temporary"
    file.write_bytes(b"\xff\xfe")
    temporary.mkdir()
    stated = {name: value.format(file=file) for name, value in variables.items()}
    made = run(DRAW, tmp_path, TMPDIR=str(temporary), **stated)
    assert made.returncode == 0, made.stderr
    assert made.stdout.strip() == f"{temporary}/virtual_phantom-{os.getuid()}/matplotlib"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["matplotlibrc", "temporary"]  # no folder "~"


def test_deleted_current_folder_is_one_line(tmp_path, monkeypatch, capsys):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert run_command(lambda words: 0, ["check", "a.yaml"]) == 1
    expected = "Error: the current folder cannot be used (No such file or directory); change to another folder\n"
    assert capsys.readouterr().err == expected


@pytest.mark.parametrize("character", ["\n", "\r", "\u2028"])
def test_path_with_a_line_break_is_one_line(capsys, character):
    assert run_command(lambda words: 0, ["init", f"a{character}b"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("contains a line break; rename the file or folder")


def test_name_that_the_locale_cannot_encode_is_one_line(tmp_path):
    """For an argument of the command line, and for a name that is read from a file."""
    start = "from virtual_phantom.base.console import run_command\n"
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for code, shown in (
        ("run_command(lambda words: 0, ['Zyste \\udcc3\\udc9f'])", "Zyste \\udcc3\\udc9f"),
        ("run_command(lambda words: open('gro\\u00df.nii'))", "gro\\xdf.nii"),
    ):
        line = f"Error: '{shown}': this name does not fit the encoding of the locale (ascii); set PYTHONUTF8=1\n"
        assert run(start + code, tmp_path, **plain).stderr == line
