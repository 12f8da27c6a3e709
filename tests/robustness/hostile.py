"""Malformed and malicious input, and its allowed outcomes: a result, or one line."""

import copy
import os
from collections import Counter

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError

EXAMPLES = int(os.environ.get("EXAMPLES", "40"))  # per fuzzed input; docs/reference/stability.md
FUZZ = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.generate],  # shrinking takes minutes; the failing input is printed unchanged
    suppress_health_check=list(HealthCheck),
)
PATIENT = "A^B"  # of the DICOM files that phantom_files writes
outcomes: Counter = Counter()  # by fuzzed input and outcome, printed at the end

ODD_TEXT = [
    "",
    "..",
    "../../etc/passwd",
    "/etc/passwd",
    "C:\\windows",
    "a b",
    "a;touch x",
    "$(touch x)",
    "`touch x`",
    "a\nb",
    "a\n",
    "\x00",
    "\u202ename",
    "\ud800",
    "{wildcard}",
    "~",
    "*",
    "-rf",
    "é" * 40,
    "x" * 300,
    "1e-4",
    "nan",
    "null",
]
ODD_NUMBERS = [0, -1, 1, 2, 10**6, 10**18, 10**400, -(10**400), 0.0, -0.0, 1e-320, 1e308, 1e-4, 0.5, float("nan")]
ODD_NUMBERS += [float("inf"), float("-inf")]
scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.sampled_from(ODD_NUMBERS),
    st.sampled_from(ODD_TEXT),
    st.integers(),
    st.floats(),
    st.text(max_size=20),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.one_of(st.sampled_from(ODD_TEXT), st.text(max_size=8), st.integers(), st.none()), inner),
    ),
    max_leaves=6,
)


def same_type(value):
    """Values of the same type, which pass the type check."""
    if isinstance(value, bool):
        return st.booleans()
    if isinstance(value, int):
        return st.sampled_from([value - 1, value + 1, 2 * value, 1, 2, 3, 1000, 10**6]) | st.integers(-5, 5000)
    if isinstance(value, float):
        return st.sampled_from([value * 1.5, value / 10, 1e-9, 1e9]) | st.floats(-1e4, 1e4)
    if isinstance(value, list) and value:
        return st.permutations(value) | st.just(value[:-1]) | st.just(value * 2)
    return values


def places(content, path=()):
    """Paths of all entries in a document of mappings and lists."""
    found = [path] if path else []
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        found += places(value, (*path, key))
    return found


@st.composite
def spoiled(draw, content: dict):
    """Document with one to three entries overwritten, removed, renamed or extended."""
    content = copy.deepcopy(content)
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 3]))):
        *parents, last = draw(st.sampled_from(places(content)))
        section = content
        for key in parents:
            section = section[key]
        change = draw(st.sampled_from(["set", "set", "set", "remove", "rename", "add"]))
        if change == "set":
            section[last] = draw(st.one_of(same_type(section[last]), same_type(section[last]), values))
        elif change == "remove":
            del section[last]
        elif change == "rename" and isinstance(section, dict):
            section[draw(st.sampled_from(ODD_TEXT) | st.text(max_size=12))] = section.pop(last)
        elif isinstance(section, dict):
            section[draw(st.text(max_size=12))] = draw(values)
        if not content:
            break
    return content


def outcome(what: str, function, *arguments):
    """Result, or None if the input was rejected in one printable line. Any other exception fails the test."""
    try:
        found = function(*arguments)
    except InputError as error:
        text = str(error)
        assert text and text.isprintable() and len(text) < 2000, text
        assert PATIENT not in text, text
        outcomes[what, "refused"] += 1
        return None
    outcomes[what, "taken"] += 1
    return found
