"""Any content of a configuration or recording.yaml gives a study or one line; never a traceback or a path outside."""

import pytest
import recording_folders as folders
import yaml
from hostile import FUZZ, ODD_TEXT, outcome, spoiled
from hypothesis import given
from hypothesis import strategies as st
from test_config import COMPARISON, DEFAULT

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.config.config import complete, read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.recordings.document import read_document
from virtual_phantom.recordings.reading import load_recording

WIDE = DEFAULT | {
    "recordings": {"scanner": "recordings/scanner"},
    "diagnosis": {"recordings": {"scanner": {"disc": {"diameter_mm": 70, "material": "pmma"}}}},
    "scans": {"narrow": {"rows": 8}},
    "reconstruction": {"sirt": {"iterations": 50}},
    "analyses": DEFAULT["analyses"] | {"comparison": {"one": COMPARISON}},
}


def plan(config):
    plan = Plan(read_study(config))
    grid_of(plan.study.grid)
    labels = sorted({plan.geometry_of(protocol) for protocol in plan.study.protocols})
    for path in (*labels, *plan.study.noise.levels, *plan.study.protocols, *plan.study.recordings):
        assert path.replace("_", "").isalnum() and path.isascii() and len(path) <= 250, path
    for label in labels:
        settings = plan.geometry_settings(label)
        scan_geometry(settings.scan, settings.projections, grid_of(plan.study.grid))
    return plan.bundles(), plan.acquisitions_with_features()


@given(spoiled(WIDE))
@FUZZ
def test_any_configuration_gives_a_plan_or_one_line(config):
    outcome("config", plan, config)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    parent = tmp_path_factory.mktemp("recordings")
    made = (folders.projections_folder, folders.images_folder, folders.features_folder)
    return [make(parent / make.__name__) for make in made]


@given(st.data())
@FUZZ
def test_any_recording_yaml_gives_a_recording_or_one_line(recordings, data):
    folder, content = data.draw(st.sampled_from(recordings))
    text = yaml.safe_dump(data.draw(spoiled(content)))
    (folder / "recording.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    outcome("recording.yaml", load_recording, folder)


@given(st.data())
@FUZZ
def test_any_text_as_recording_yaml_gives_one_line(recordings, data):
    folder, content = data.draw(st.sampled_from(recordings))
    text = yaml.safe_dump(content)
    start = data.draw(st.integers(0, len(text)))
    odd = st.sampled_from(["!!python/object/apply:os.system ['touch x']", "&a [*a]", "\t", "%", "{{", "? : -", "\x07"])
    text = text[:start] + data.draw(odd | st.text(max_size=30)) + text[start + data.draw(st.integers(0, 30)) :]
    (folder / "recording.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    outcome("text of recording.yaml", read_document, folder)


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 9)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize("text", [BOMB, "a: &a [*a]\n", "a: " + "[" * 400 + "]" * 400, "a: &a {b: *a}\n"])
def test_exponentially_nested_aliases_are_rejected_at_once(text, tmp_path):
    (tmp_path / "recording.yaml").write_text(text)
    with pytest.raises(InputError):
        read_document(tmp_path)
    if "[[[" not in text:
        with pytest.raises(InputError, match="is nested"):
            complete(DEFAULT | {"protocols": yaml.safe_load(text)})


NO_FOLDER = ("", "{wildcard}", "a\nb", "a\n", "\x00", "\ud800")  # other unusual names can be folders that users want


@pytest.mark.parametrize("name", [name for name in ODD_TEXT if name not in ("1e-4", "nan", "null")])
def test_invalid_names_are_rejected(name, tmp_path):
    """Wherever a name becomes a part of a path, of a rule or of a label."""
    protocol = {"algorithm": "sirt", "projections": 3}
    for change in (
        {"protocols": DEFAULT["protocols"] | {name: protocol}},
        {"scans": {name: {"rows": 8}}},
        {"recordings": {name: "somewhere"}},
        {"noise": {"levels": DEFAULT["noise"]["levels"] | {name: {"A": 1e-4, "repeats": 2}}}},
        {"results_dir": name}
        if name in ("", "{wildcard}", "a\nb", "a\n", "\x00", "\ud800")
        else {"recordings": {name: 1}},
    ):
        with pytest.raises(InputError):
            complete(DEFAULT | change)
    folder, content = folders.images_folder(tmp_path / "r")
    for path in ("name", "rois", "repeats"):
        value = {"name": name, "rois": [{"name": name, "tissue_class": "x", "label": 1}], "repeats": [name]}[path]
        text = yaml.safe_dump(content | {path: value})
        (folder / "recording.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
        with pytest.raises(InputError):
            load_recording(folder)
