"""Scripts of the workflow are modules: importing one runs nothing, and `main` has typed arguments."""

import importlib.util
import inspect
import subprocess
import sys
import typing
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "workflow" / "scripts"
USE_X86 = "proof_record.py"  # a command with its own arguments, which no rule runs
# Packages that read the number of threads when they are loaded: `job` sets it before `main` loads them.
READS_THREADS = ("numba", "astra")
PATHS = sorted(SCRIPTS.rglob("*.py"))
LOADED_LAZILY = ("acquire", "compile_kernels", "project", "reconstruct")


def imported(path):
    spec = importlib.util.spec_from_file_location(f"script_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.relative_to(SCRIPTS).as_posix())
def test_script_can_be_imported_and_its_main_is_annotated(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main = imported(path).main
    assert not list(tmp_path.iterdir()) and capsys.readouterr() == ("", "")
    parameters = inspect.signature(main).parameters.values()
    assert typing.get_type_hints(main).keys() == {parameter.name for parameter in parameters} | {"return"}
    assert all(parameter.kind is parameter.KEYWORD_ONLY for parameter in parameters)
    assert bool(parameters) != (path.name == USE_X86)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.relative_to(SCRIPTS).as_posix())
def test_script_passes_every_argument_of_its_main(path):
    """By name, inside `with job(snakemake)` at its end."""
    if path.name == USE_X86:
        return
    *_, end = path.read_text().split('\nif "snakemake" in globals():\n    with job(snakemake):\n        main(')
    keywords = dict.fromkeys(inspect.signature(imported(path).main).parameters)

    class Anything:
        """Replacement of any attribute, item or call of `snakemake`."""

        def __getattr__(self, name):
            return self

        def __getitem__(self, key):
            return self

        def __int__(self):
            return 1

        def __iter__(self):
            return iter(())  # with __getitem__ alone, iteration would not end

        def __call__(self, *arguments):
            return self

    names = {**imported(path).__dict__, "snakemake": Anything(), "dict": dict}
    if "from_mapping" in names:
        names["from_mapping"] = lambda kind, value: value  # it would iterate over Anything without end
    call = eval(f"dict({end}", names)
    assert call.keys() == keywords.keys()


@pytest.mark.parametrize("name", LOADED_LAZILY)
def test_jobs_with_several_threads_load_packages_after_the_number_is_set(name):
    program = (
        "import importlib.util, sys\n"
        f"spec = importlib.util.spec_from_file_location('script', {str(SCRIPTS / f'{name}.py')!r})\n"
        "spec.loader.exec_module(importlib.util.module_from_spec(spec))\n"
        f"print(*set({READS_THREADS}) & set(sys.modules))"
    )
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == ""
