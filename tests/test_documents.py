"""Documents with a schema: rejected on writing and reading, in a line that names the key."""

import json

import pytest

from virtual_phantom.base.data import SCHEMAS
from virtual_phantom.base.errors import InputError
from virtual_phantom.io.documents import DIAGNOSIS, SCORE, read_document, schema_of_kind, write_document
from virtual_phantom.io.schema import read_schema

DOCUMENT = {
    "recording": "disc",
    "verdict": "match",
    "sentence": "disc and the simulation agree",
    "excess_removed": None,
    "held_out_data": "every second view",
    **{key: {} for key in ("ambiguous_with", "ruled_out", "fit", "held_out")},
    **{key: [] for key in ("locations", "effects", "unexplained", "next_measurement")},
}


def test_document_is_read_back(tmp_path):
    write_document(DOCUMENT, tmp_path / "d.json", DIAGNOSIS)
    assert read_document(tmp_path / "d.json", DIAGNOSIS) == DOCUMENT


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"verdict": "perhaps"}, "verdict"),
        ({"excess_removed": 1.5}, "excess_removed"),
        ({"unheard": 1}, "unheard"),
        ({"locations": [{"domain": "views", "where": "view 1", "z": 4.0, "p": 2.0, "map": "views.npy"}]}, "p"),
        ({"effects": [{"name": "scatter"}]}, "physics"),
    ],
)
def test_invalid_document_is_neither_written_nor_read(tmp_path, change, named):
    path = tmp_path / "d.json"
    with pytest.raises(InputError, match=named) as error:
        write_document(DOCUMENT | change, path, DIAGNOSIS)
    assert "\n" not in str(error.value) and not path.exists()
    path.write_text(json.dumps(DOCUMENT | change))
    with pytest.raises(InputError, match=named) as error:
        read_document(path, DIAGNOSIS)
    assert str(error.value).startswith(f"{path}: is no diagnosis.json") and "\n" not in str(error.value)


@pytest.mark.parametrize("text", [None, "{", "[1]", '{"verdict": NaN}'])
def test_other_files_are_rejected(tmp_path, text):
    if text is not None:
        (tmp_path / "d.json").write_text(text)
    with pytest.raises(InputError, match="is no score.json"):
        read_document(tmp_path / "d.json", SCORE)


@pytest.mark.parametrize("kind", [DIAGNOSIS, SCORE])
def test_every_key_of_a_schema_has_a_type(kind):
    """Required keys are described, which excludes misspelled ones."""
    schema = schema_of_kind(kind)
    assert set(schema["required"]) <= set(schema["properties"])


@pytest.mark.parametrize("path", sorted(SCHEMAS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_name_in_a_schema_is_text(path):
    """YAML reads an unquoted off as False, which no document contains."""

    def names(node):
        if isinstance(node, dict):
            yield from node
            yield from node.get("required", []) if isinstance(node.get("required"), list) else []
            for value in node.values():
                yield from names(value)
        elif isinstance(node, list):
            for value in node:
                yield from names(value)

    found = list(names(read_schema(path)))
    assert len(found) > 10 and [one for one in found if not isinstance(one, str)] == []
