"""Compiled kernels on disk: concurrent writers, damaged files, and read-only folders."""

import errno
import importlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from virtual_phantom.base import compiled as module
from virtual_phantom.base.cache_folders import user_cache
from virtual_phantom.base.compiled import SUFFIX, KernelCache
from virtual_phantom.base.errors import InputError

LIBRARY = Path(module.__file__).resolve().parents[1]
WIDTHS = {
    13: 16,
    2: 64,
}  # Columns of a tile of kernels.py by the number of realizations: TILE above FEW, otherwise WIDER.
# Two processes have both read the cache before either writes. The second writes its index last, the first its data:
# with Numba's own cache, the index then pairs the second's signature with the first's code.
RACE = """
import os, sys, time
from pathlib import Path
flags, me, lanes = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
other = {"first": "second", "second": "first"}[me]
WAITS_FOR = {("first", 1): "second ready", ("second", 1): "first 1", ("first", 2): "second ended"}
replace, count = os.replace, 0

def wait(name):
    until = time.monotonic() + 60
    while not (flags / name).exists():
        assert time.monotonic() < until, name
        time.sleep(0.005)

def ordered(source, target):
    global count
    count += 1
    (flags / f"{me} ready").touch()
    if (me, count) in WAITS_FOR:
        wait(WAITS_FOR[me, count])
    replace(source, target)
    (flags / f"{me} {count}").touch()

from virtual_phantom.projectors.kernels import tile_width
os.replace = ordered
print(tile_width((0,) * lanes))
(flags / f"{me} ended").touch()
"""
LOADED = """
import sys
from virtual_phantom.projectors.kernels import tile_width
for lanes in sys.argv[1:]:
    print(tile_width((0,) * int(lanes)))
print(sum(tile_width.stats.cache_hits.values()), sum(tile_width.stats.cache_misses.values()))
"""


def start(program, *words, library=LIBRARY.parent, **variables):
    environment = {**os.environ, "PYTHONPATH": str(library), **variables}
    words = (sys.executable, "-c", program, *map(str, words))
    return subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def lines(process):
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out.split("\n")[:-1], err


def test_two_processes_that_compile_two_signatures_at_once_keep_both(tmp_path):
    flags, cache = tmp_path / "flags", tmp_path / "cache"
    flags.mkdir()
    names = {"first": 13, "second": 2}
    racing = [start(RACE, flags, *one, NUMBA_CACHE_DIR=str(cache)) for one in names.items()]
    assert [lines(process)[0] for process in racing] == [[str(WIDTHS[lanes])] for lanes in names.values()]
    assert lines(start(LOADED, *WIDTHS, NUMBA_CACHE_DIR=str(cache)))[0] == [*map(str, WIDTHS.values()), "2 0"]


def count(lanes):
    return 10 * len(lanes)


def state_folder(monkeypatch, folder):
    """Set the cache folder as NUMBA_CACHE_DIR would have on import; Numba's compiler reads changed variables again."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    monkeypatch.setattr(module.numba.config, "CACHE_DIR", str(folder))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A folder with the compiled code of `count` for two signatures."""
    folder = tmp_path / "cache"
    state_folder(monkeypatch, folder)
    assert [counted(lanes) for lanes in (2, 3)] == [(20, "compiled"), (30, "compiled")]
    return folder


def counted(lanes):
    """Result of a dispatcher without known signatures, and the source of its code."""
    dispatcher = module.compiled()(count)
    value = dispatcher((0,) * lanes)
    return value, "loaded" if sum(dispatcher.stats.cache_hits.values()) else "compiled"


def truncate(first, second):
    first.write_bytes(first.read_bytes()[:-1])


def empty(first, second):
    first.write_bytes(b"")


def flip_one_bit(first, second):
    content = bytearray(first.read_bytes())
    content[len(content) // 2] ^= 1
    first.write_bytes(content)


def take_the_code_of_another_signature(first, second):
    shutil.copy(second, first)


def remove(first, second):
    first.unlink()


def put_a_broken_link_there(first, second):
    first.unlink()
    first.symlink_to("missing")


@pytest.mark.parametrize(
    "damage", [truncate, empty, flip_one_bit, take_the_code_of_another_signature, remove, put_a_broken_link_there]
)
def test_damaged_code_is_compiled_again_and_replaced(cache, damage):
    by_content = sorted(cache.iterdir(), key=lambda path: b"i64, 2" in path.read_bytes())
    for first, second in (by_content, by_content[::-1]):
        intact = second.read_bytes()
        damage(first, second)
        assert sorted(counted(lanes) for lanes in (2, 3)) != [(20, "loaded"), (30, "loaded")]
        assert [counted(lanes) for lanes in (2, 3)] == [(20, "loaded"), (30, "loaded")]
        assert second.read_bytes() == intact
    assert len([*cache.iterdir()]) == 2  # nothing temporary remains


def test_folder_in_the_place_of_code_only_costs_time(cache, monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(module, "PACKAGE_CACHE", tmp_path / "beside")
    for path in [*cache.iterdir()]:
        path.unlink()
        path.mkdir()
    assert [counted(lanes) for lanes in (2, 2)] == [(20, "compiled")] * 2


def test_code_of_another_version_is_not_run(cache, monkeypatch):
    monkeypatch.setattr(module.llvmlite, "__version__", "0.1")
    assert counted(2) == (20, "compiled")
    monkeypatch.undo()


def test_every_compiled_function_of_the_library_uses_the_cache():
    """Numba's own cache is not used, and the private names that the cache relies on exist."""
    dispatchers = {}
    for path in LIBRARY.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "compiled" not in text and "njit" not in text:
            continue
        found = importlib.import_module(".".join(path.relative_to(LIBRARY.parent).with_suffix("").parts))
        dispatchers |= {f"{path.stem}.{name}": one for name, one in vars(found).items() if isinstance(one, Dispatcher)}
    assert len(dispatchers) > 25
    assert not [name for name, one in dispatchers.items() if not isinstance(one._cache, KernelCache)]


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A file, in which no folder can be made, and a folder; the package's own folder is read-only."""
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.touch()
    folder.mkdir()
    monkeypatch.setattr(module, "PACKAGE_CACHE", file / "kernels")
    monkeypatch.setattr(tempfile, "tempdir", None)
    for cached in (module._usable, module._note_once):
        cached.cache_clear()

    def state(stated, **variables):
        state_folder(monkeypatch, stated.format(file=file, folder=folder))
        for name, value in variables.items():
            monkeypatch.setenv(name, value.format(file=file, folder=folder))

    return file, folder, state


@pytest.mark.parametrize(
    ("stated", "variables", "kept_in"),
    [
        ("{folder}/a/b", {}, "a/b"),
        ("~/kernels", {"HOME": "{folder}"}, "kernels"),
        ("", {"XDG_CACHE_HOME": "{folder}"}, "virtual_phantom/kernels"),
        ("", {"XDG_CACHE_HOME": "relative", "HOME": "{folder}"}, ".cache/virtual_phantom/kernels"),
        ("", {"XDG_CACHE_HOME": "{file}", "TMPDIR": "{folder}"}, f"virtual_phantom-{os.getuid()}/kernels"),
        ("{file}", {"XDG_CACHE_HOME": "{folder}"}, "virtual_phantom/kernels"),
    ],
)
def test_code_is_stored_in_the_first_writable_folder(places, caplog, stated, variables, kept_in):
    file, folder, state = places
    state(stated, **variables)
    assert [counted(2), counted(2)] == [(20, "compiled"), (20, "loaded")]
    (stored,) = folder.rglob(f"*{SUFFIX}")
    assert stored.parent == folder / kept_in
    line = (
        f"NUMBA_CACHE_DIR: {file} cannot be written to (Not a directory); compiled kernels are kept in {stored.parent}"
    )
    assert caplog.messages == ([line] if stated == "{file}" else [])


def test_code_is_not_stored_where_others_could_have_written_it(places):
    _, folder, state = places
    state("", XDG_CACHE_HOME="{file}", TMPDIR="{folder}")
    assert counted(2) == (20, "compiled") and counted(2) == (20, "loaded")
    (folder / f"virtual_phantom-{os.getuid()}").chmod(0o777)
    assert counted(2) == (20, "compiled")


def test_cache_folder_of_another_user_is_not_used(tmp_path, monkeypatch):
    folder = tmp_path / "virtual_phantom"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache() == folder  # does not exist yet
    folder.mkdir()
    assert user_cache() == folder
    monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    assert user_cache() is None


def test_without_a_writable_folder_functions_run_with_one_note(places, caplog, monkeypatch):
    file, _, state = places
    state("{file}", XDG_CACHE_HOME="{file}")
    monkeypatch.setattr(tempfile, "tempdir", str(file))
    assert [counted(2), counted(3)] == [(20, "compiled"), (30, "compiled")]
    no = "Not a directory"
    tried = f"{file}: {no}, {file}/kernels: {no}, {file}/virtual_phantom/kernels: {no}"
    assert caplog.messages == [
        f"compiled kernels cannot be kept ({tried}), and each process compiles them again; set NUMBA_CACHE_DIR to a "
        "folder that can be written to"
    ]


def test_read_only_folder_is_read(cache, monkeypatch):
    """As in a container whose image contains compiled code."""
    monkeypatch.setattr(module, "_write", raise_read_only)
    monkeypatch.setattr(module, "PACKAGE_CACHE", cache)
    state_folder(monkeypatch, "")
    assert counted(3) == (30, "loaded")


def raise_read_only(path, content):
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def test_disabled_compiler_is_one_line(monkeypatch):
    monkeypatch.setattr(module.numba.config, "DISABLE_JIT", 1)
    line = "NUMBA_DISABLE_JIT: Numba's compiler is off, and kernels run only compiled; unset it"
    with pytest.raises(InputError, match=f"^{line}$"):
        module.compiled()
