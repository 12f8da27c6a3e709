"""Write docs/thresholds.md: every number at the head of a module that decides something, with its source.

The numbers stay where they are used. They are read from the code, each with the comment that stands beside or above it,
so that the table cannot say anything else than the code does.
"""

import ast
import io
import tokenize
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = ROOT / "workflow" / "lib" / "virtual_phantom"
TARGET = ROOT / "docs" / "thresholds.md"
# Rooms whose numbers decide what is said, and what each is about.
ROOMS = {
    "diagnosis": "Diagnosis",
    "statistics": "Statistics",
    "phantom": "CT and regions: what is refused or remarked on, and where the body is",
    "recordings": "Recordings: what is refused or remarked on, and how they are aligned",
    "features": "Features",
    "physics": "Physics: where formulas hold, and how finely they are worked out",
    "proof/score": "Proof",
}

INTRODUCTION = """# Thresholds

Every number at the head of a module that decides what is said, what is refused, or how finely something is worked out.
Each row gives the meaning and the source of the constant: a paper, a derivation, or the measurement that set it. A
constant without a source is a choice. Settings that a user may change are in [the configuration](../config/README.md),
and plausible ranges of effects' parameters in [the effects](physics.md). This page is made from the code by
`python docs/thresholds.py`.
"""


HEADER = "| where | name | value | meaning and source |\n|---|---|---|---|\n"


@dataclass(frozen=True)
class Threshold:
    """A number of a module: its name, its value as it is written, and the comment that says what it is of."""

    module: str
    name: str
    value: str
    comment: str


def thresholds(path: Path) -> list[Threshold]:
    """Those of a module, in the order of its lines."""
    text = path.read_text(encoding="utf-8")
    comments = comments_of(text)
    lines = text.splitlines()
    found = []
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign) or not is_number(node.value):
            continue
        target = node.targets[0]
        names = [one.id for one in target.elts] if isinstance(target, ast.Tuple) else [target.id]
        if not all(name.isupper() for name in names):
            continue
        said = comments.get(node.end_lineno, "")
        above, line = [], node.lineno - 1
        while line in comments and lines[line - 1].lstrip().startswith("#"):
            above.insert(0, comments[line])
            line -= 1
        value = ast.get_source_segment(text, node.value)
        words = " ".join([*above, *([said] if said else [])])
        found.append(Threshold(path.relative_to(LIBRARY).as_posix(), ", ".join(names), value, words))
    return found


def is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, or a tuple or dictionary of such."""
    if isinstance(node, ast.Tuple):
        return all(map(is_number, node.elts))
    if isinstance(node, ast.Dict):
        return all(map(is_number, node.values))
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def comments_of(text: str) -> dict[int, str]:
    """The comment on every line that has one."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {one.start[0]: one.string.lstrip("# ") for one in tokens if one.type == tokenize.COMMENT}


def every_threshold() -> dict[str, list[Threshold]]:
    """By room."""
    return {
        room: [one for path in sorted((LIBRARY / room).rglob("*.py")) for one in thresholds(path)] for room in ROOMS
    }


def page() -> str:
    """The page."""
    parts = [INTRODUCTION]
    for room, found in every_threshold().items():
        parts.append(f"\n## {ROOMS[room]}\n\n{HEADER}")
        for one in found:
            place = one.module.removeprefix(f"{room}/").removesuffix(".py")
            value, comment = (part.replace("|", "\\|") for part in (" ".join(one.value.split()), one.comment))
            parts.append(f"| {place} | `{one.name}` | `{value}` | {comment} |\n")
    return "".join(parts)


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
