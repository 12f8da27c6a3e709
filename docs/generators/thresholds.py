"""Page of the thresholds: numbers at the head of a module that decide something, with their comments.

The numbers stay in the modules that use them. The page is read from the code, so it cannot differ from it.
"""

import ast
import io
import tokenize
from dataclasses import dataclass
from functools import cache
from pathlib import Path

LIBRARY = Path(__file__).resolve().parents[2] / "workflow" / "lib" / "virtual_phantom"
SECTIONS = {  # package: heading
    "diagnosis": "Diagnosis",
    "statistics": "Statistics",
    "phantom": "Phantoms from CT: accepted images and regions, body outline",
    "recordings": "Recordings: accepted files, alignment",
    "features": "Features",
    "physics": "Physics: validity of formulas, discretization",
    "simulation": "Simulation",
    "proof/scoring": "Blind validation",
}
INTRODUCTION = """# Thresholds

The numbers in the code that decide a verdict, refuse an input or set a discretization. Each row gives the meaning and
the source of the constant: a paper, a derivation or a measurement. A constant without a source is a choice. See
[configuration](configuration.md) for settings that you can change, and [effects](effects.md) for plausible ranges.
"""
HEADER = "| constant | value | meaning and source |\n|---|---|---|\n"


@dataclass(frozen=True)
class Threshold:
    """A constant of a module, with its value as it is written in the code and its comment."""

    module: str
    name: str
    value: str
    comment: str


def thresholds(path: Path) -> list[Threshold]:
    """Return the thresholds of a module, in the order of its lines."""
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
    """Whether an expression is a number, or a tuple or dictionary of numbers."""
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
    """Return {line: comment}."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {one.start[0]: one.string.lstrip("# ") for one in tokens if one.type == tokenize.COMMENT}


@cache
def every_threshold() -> dict[str, list[Threshold]]:
    """Return the thresholds of each package in SECTIONS."""
    return {
        package: [found for path in sorted((LIBRARY / package).rglob("*.py")) for found in thresholds(path)]
        for package in SECTIONS
    }


def page() -> str:
    """Return the page."""
    parts = [INTRODUCTION]
    for package, found in every_threshold().items():
        if found:
            parts.append(f"\n## {SECTIONS[package]}\n\n{HEADER}")
        for threshold in found:
            module = threshold.module.removeprefix(f"{package}/").removesuffix(".py")
            value, comment = (
                cell.replace("|", "\\|") for cell in (" ".join(threshold.value.split()), threshold.comment)
            )
            parts.append(f"| `{threshold.name}` in {module} | `{value}` | {comment} |\n")
    return "".join(parts)
