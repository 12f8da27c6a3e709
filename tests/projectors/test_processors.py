"""Kernels for every kind of processor that this machine can emulate, against each other and known truths."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.codegen import get_host_cpu_features
from one_alone import CASES, projected

from virtual_phantom.projectors.processors import ANY, AVX2, AVX512, KINDS, kind_of

HERE = Path(__file__).resolve().parent
# Tests of a single realization against independent truths, its transpose, many realizations and guard pages.
TRUTHS = "test_cpu and (ellipsoid or test_adjoint or single_lane or beyond_arrays or astra)"
# Test of the scenes' kernel, for all rows at once, against the one for single rows.
SCENES = "test_scene and path_lengths"
# Variables that select an instruction set; for AVX2, x86-64-v3, the lowest level with it.
SELECTED = {
    AVX2: {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": "+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sse3,+ssse3,+sse4.1,+sse4.2",
    },
    ANY: {"NUMBA_CPU_NAME": "generic"},
}


@pytest.fixture(scope="module", params=KINDS)
def variables(request, tmp_path_factory):
    """Environment of a process for one kind, with its own compiled kernels; those of this processor are reused."""
    own = kind_of(get_host_cpu_features())
    if KINDS.index(request.param) < KINDS.index(own):
        pytest.skip(f"this processor has no {request.param}")
    made = dict(os.environ)
    if request.param != own:
        made |= SELECTED[request.param] | {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    return made | {"PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.fixture(scope="module")
def several():
    """Results of several realizations by this processor's own kind, of each case."""
    return [projected(case, 3) for case in CASES]


def run(command, variables):
    done = subprocess.run([sys.executable, *map(str, command)], env=variables, capture_output=True, text=True)
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    return done.stdout


def test_all_kinds_give_equal_projections(variables, several, tmp_path):
    if variables.get("NUMBA_CPU_NAME") is None:
        pytest.skip("this processor's own kind: test_cpu.py itself")
    run([HERE / "one_alone.py", tmp_path / "made.npz"], variables)
    there = np.load(tmp_path / "made.npz")
    for i, (case, expected) in enumerate(zip(CASES, several, strict=True)):
        for j, here in enumerate(expected):
            assert here.any()
            np.testing.assert_allclose(there[f"{i}-{j}"], here, atol=3e-6 * here.max(), err_msg=f"{case}, {j}")


def test_truths_apply_to_all_kinds(variables):
    if variables.get("NUMBA_CPU_NAME") is None:
        pytest.skip("this processor's own kind: test_cpu.py and test_scene.py themselves")
    files = (HERE / "test_cpu.py", HERE.parent / "physics" / "test_scene.py")
    output = run(["-m", "pytest", "-x", "-p", "no:xdist", *files, "-k", f"({TRUTHS}) or ({SCENES})"], variables)
    assert int(re.search(r"(\d+) passed", output)[1]) >= 13 + 6


def test_process_uses_the_selected_kind(variables, request):
    settings = request.node.callspec.params["variables"]
    script = "from virtual_phantom.projectors.processors import PROCESSOR; print(PROCESSOR)"
    assert run(["-c", script], variables).strip() == settings


@pytest.mark.parametrize(
    "features, kind", [("+sse2,+avx2,+avx512f", AVX512), ("+avx2,-avx512f", AVX2), ("+neon", ANY), ("", ANY)]
)
def test_kind_of_features(features, kind):
    assert kind_of(features) == kind
