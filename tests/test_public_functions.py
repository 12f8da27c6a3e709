"""Wrong arguments of public functions are InputErrors that name the argument; faults say how to report them."""

import datetime
import inspect

import numpy as np
import pytest
import recording_folders

import virtual_phantom as vp
from virtual_phantom.api import simulated
from virtual_phantom.api.arguments import UnexpectedError, public
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import Phantom, Roi

FUNCTIONS = ("draw_phantom", "read_phantom", "scan", "reconstruct", "extract", "diagnose")
WRONG = [None, True, -1, 2.5, float("nan"), "x", b"x", [], {}, [1, 2], {"a": 1}, object(), np.array(3), 1j, "a\0b"]
WRONG += [np.zeros((2, 2)), datetime.date(2020, 1, 1), (1,), ("a", {}), [[1, 2], [3, 4]]]

OBJECT = next(place for place, value in enumerate(WRONG) if type(value) is object)


@pytest.fixture(scope="module")
def phantom():
    image = Volume(np.zeros((4, 8, 8), np.float32), Grid((4, 8, 8), (5.0, 5.0, 5.0)))
    return Phantom(image, image, ())


def test_images_and_projections_are_not_printed():
    roi = Roi("liver", "organ", np.ones((4, 8, 8), bool))
    image = Volume(np.zeros((4, 8, 8), np.float32), Grid((4, 8, 8), (5.0, 5.0, 5.0)))
    scan = vp.scan(Phantom(image, image, (roi,)), projections=4)
    shown = f"{roi} {image} {scan}"
    assert not any(f"{name}=" in shown for name in ("mask", "array", "line_integrals", "clean"))


def kinds(function, **values):
    """Call a function with each wrong value: it accepts the value or raises InputError, and rejects an object."""
    (name,) = [name for name, value in values.items() if value is WRONG]
    refused = set()
    for place, value in enumerate(WRONG):
        try:
            function(**{**values, name: value})
        except InputError as error:
            assert "\n" not in str(error), error
            refused.add(place)
        except BaseException as error:
            raise AssertionError(f"{name}={value!r}: {error!r}") from error
    assert OBJECT in refused


@pytest.mark.parametrize("name", ["image", "rois", "labels", "shape", "spacing_mm", "oversampling", "keep_mm", "other"])
def test_ct_is_read_or_rejected(name):
    kinds(vp.read_phantom, **{"image": "none.nii", "rois": [{"name": "a", "tissue_class": "b"}], name: WRONG})


@pytest.mark.parametrize(
    "name", ["phantom", "projections", "noise_level", "physics", "stream", "columns", "pitch", "beam"]
)
def test_scan_is_made_or_rejected(name, phantom, monkeypatch):
    monkeypatch.setattr(simulated, "project_phantom", lambda *_, **__: (np.zeros((1, 1, 1)), None))
    monkeypatch.setattr(
        simulated, "acquire", lambda *_, **__: type("A", (), {"line_integrals": lambda *_: np.zeros(1)})
    )
    kinds(vp.scan, **{"phantom": phantom, "projections": 4, name: WRONG})


@pytest.mark.parametrize("name", ["scan", "algorithm", "engine", "threads", "normalise"])
def test_images_are_made_or_rejected(name):
    kinds(vp.reconstruct, **{"scan": None, name: WRONG})


@pytest.mark.parametrize("name", ["disc", "mask", "labels", "shapes", "recording", "effects", "matters", "alignment"])
def test_recording_is_diagnosed_or_rejected(name, tmp_path):
    values = {"recording": tmp_path} if name in ("disc", "mask", "labels", "shapes") else {"disc": (70.0, "water")}
    kinds(vp.diagnose, **{"recording": tmp_path, **values, name: WRONG})


@pytest.mark.parametrize(
    "call, line",
    [
        (lambda one: vp.draw_phantom((12, 40)), "shape: (12, 40) is not three numbers (z, y, x); give three"),
        (lambda one: vp.draw_phantom((12, 40.5, 40)), "shape[1]: 40.5 is not a whole number of at least 1; give one"),
        (
            lambda one: vp.draw_phantom((10**6, 10**6, 10**6)),
            "shape (1000000, 1000000, 1000000) with oversampling 2: needs 3.2e+10 GB of memory, but the machine has",
        ),
        (lambda one: vp.draw_phantom(spacing_mm="abc"), "spacing_mm: 'abc' is not three numbers (z, y, x); give three"),
        (lambda one: vp.draw_phantom(seed="a"), "seed: 'a' is not a whole number of at least 0; give one"),
        (lambda one: vp.draw_phantom(shpe=3), "draw_phantom: got an unexpected keyword argument 'shpe'; did you mean"),
        (lambda one: vp.draw_phantom(oversampling=99), "oversampling: 99 is more than 8; give less"),
        (lambda one: vp.read_phantom(3, []), "image: 3 is not a path; give the path of a file or folder as text"),
        (lambda one: vp.scan("phantom"), "phantom: is of type str; give what draw_phantom or read_phantom returns"),
        (lambda one: vp.scan(one, noise_level=0), "noise_level: 0 is not a number above 0; give one"),
        (lambda one: vp.scan(one, physics={"scatter": 3}), "physics.scatter is 3; give a mapping of its parameters"),
        (lambda one: vp.scan(one, physics=["scatter"]), "physics: ['scatter'] is not a mapping; give {effect:"),
        (lambda one: vp.scan(one, pitch=float("inf")), "scan: pitch is inf; give a finite number"),
        (lambda one: vp.reconstruct([1]), "scan: is of type list; give what vp.scan returns"),
        (lambda one: vp.extract([3], one), "images[0]: is of type int; give what vp.reconstruct returns"),
        (lambda one: vp.extract([], one), "images: is empty; give at least one image"),
        (lambda one: vp.diagnose("a", disc=70.0), "disc: 70.0 is not a pair; give diameter in mm and material"),
        (lambda one: vp.diagnose("a", disc=("70", "water")), "disc[0]: '70' is not a number above 0; give one"),
        (lambda one: vp.diagnose("a", disc=(70, "water"), effects="scatter"), "effects: 'scatter' is not a list; give"),
        (
            lambda one: vp.diagnose("a", disc=(70, "water"), processes=0),
            "processes: 0 is not a whole number of at least",
        ),
    ],
)
def test_line_names_the_argument(call, line, phantom, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as error:
        call(phantom)
    assert str(error.value).startswith(line)


def test_numpy_arrays_and_numbers_are_accepted():
    drawn = vp.draw_phantom(np.array((12, 40, 40)), np.array((8.0, 7.5, 7.5)), oversampling=np.int64(1))
    assert drawn.image.grid.shape == (12, 40, 40)


def test_diagnosis_takes_numpy_numbers_and_paths(tmp_path):
    recording_folders.projections_folder(tmp_path / "bench")
    wanted = {"view_step": np.int64(2), "samples": np.int64(0), "matters": {"hu": np.float32(5)}}
    with pytest.raises(InputError, match="^diagnose: samples: 0 is less than the minimum of 1"):
        vp.diagnose(tmp_path / "bench", mask=(tmp_path / "object.nii", "water"), **wanted)


@pytest.mark.parametrize("key", ["protocol", "physics_from", "baseline_from"])
def test_diagnosis_of_one_recording_rejects_keys_of_a_study(tmp_path, key):
    recording_folders.projections_folder(tmp_path / "bench")
    with pytest.raises(InputError, match=f"^diagnose: .*{key}"):
        vp.diagnose(tmp_path / "bench", disc=(70, "water"), **{key: "another"})


def test_internal_error_is_one_line_with_what_to_report():
    @public
    def broken(one):
        return [][one]

    with pytest.raises(UnexpectedError) as error:
        broken(3)
    assert str(error.value) == (
        "broken: unexpected IndexError: list index out of range; this is a fault of Virtual Phantom: report it with "
        "the traceback above"
    )
    assert isinstance(error.value.__cause__, IndexError)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_signature_and_documentation_are_the_functions_own(name):
    function = getattr(vp, name)
    assert inspect.getdoc(function) and "arguments" not in inspect.signature(function).parameters
