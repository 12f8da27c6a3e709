"""The generator and the diagnosis of the blind validation are independent: no shared physics is loaded."""

import pytest
from loaded import LIBRARY, ROOT, loaded

SCRIPTS = ROOT / "workflow/scripts"
# Modules without radiation physics: files, grids, phantom layouts, and the list of the library's effects.
MAY_BE_LOADED = {
    *("base", "base.console", "base.data", "base.errors", "base.geometry", "base.home", "base.pose", "base.streams"),
    *("base.units", "base.vectors", "base.names", "base.settings", "base.proof_settings", "io.yaml_files"),
    *("features", "features.names"),
    *("io", "io.files", "io.hdf5", "io.schema", "io.volumes", "study", "study.config", "study.job"),
    *("study.progress", "study.progress.job_status"),
    *(
        "phantom",
        "phantom.grid_size",
        "phantom.layout",
        "phantom.rois",
        "phantom.shapes",
        "phantom.synthetic",
        "phantom.texture",
    ),
    *("physics", "physics.effect", "recordings", "recordings.document"),
    "physics.effects",  # the package's own file is empty: each effect is a separate module
    *("statistics", "statistics.measured"),
}


def modules(folder):
    """Names of the modules in a folder of the library."""
    files = (LIBRARY / "virtual_phantom" / folder).glob("**/*.py")
    return [".".join(path.relative_to(LIBRARY).with_suffix("").parts) for path in files if path.stem != "__init__"]


def of_the_proof(names):
    return {name for name in names if name.split(".")[0] == "proof"}


def test_generator_of_recordings_loads_no_physics_of_the_library():
    found = loaded(SCRIPTS / "scan_proof.py", named=modules("proof/hiding/hooks"))
    assert {"proof.hiding.xcist", "proof.hiding.readout", "proof.hiding.hooks.flux"} <= found
    assert found - of_the_proof(found) <= MAY_BE_LOADED


def test_diagnosis_loads_no_module_of_the_blind_validation():
    scripts = [*SCRIPTS.glob("diagnose*.py"), SCRIPTS / "agreement_other_protocol.py"]
    found = loaded(*scripts, named=[*modules("diagnosis"), *modules("physics/effects")])
    assert {"diagnosis.verdict.verdict", "physics.chain", "physics.effects.scatter"} <= found
    assert of_the_proof(found) == set()


@pytest.mark.parametrize(
    ("statement", "caught"),
    [
        ("import virtual_phantom.proof.seal", {"proof", "proof.seal"}),
        ("from virtual_phantom import proof", {"proof"}),
        ("from .. import proof", {"proof"}),
        ("from ..proof.seal import read", {"proof", "proof.seal"}),
        ("def later():\n    if True:\n        from .. import proof", {"proof"}),
        ("from . import other", {"proof", "proof.seal"}),
        ("import numpy", set()),
        ("import not_installed_here", set()),
    ],
)
def test_all_forms_of_import_are_detected(tmp_path, statement, caught):
    files = {
        "__init__.py": "",
        "diagnosis/__init__.py": "",
        "diagnosis/verdict.py": statement if "not_installed" not in statement else f"def later():\n    {statement}",
        "diagnosis/other.py": "def later():\n    from virtual_phantom.proof import seal",
        "proof/__init__.py": "",
        "proof/seal.py": "read = open",
    }
    for name, text in files.items():
        path = tmp_path / "virtual_phantom" / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text + "\n")
    script = tmp_path / "diagnose.py"
    script.write_text("from virtual_phantom.diagnosis import verdict\n")
    found = loaded(script, library=tmp_path)
    assert "diagnosis.verdict" in found and of_the_proof(found) == caught
