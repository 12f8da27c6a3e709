"""Check the project's prose against its style: `python tests/prose.py [PATH ...]` prints `file:line: rule: text`.

It reads pages, docstrings, comments, descriptions in YAML files and strings that look like sentences. The rules are
MAX_WORDS, WORDS, SPELLING and STARTS. Without PATH, it checks the whole project except UNCONVERTED, the paths that are
not rewritten yet.
"""

import ast
import inspect
import io
import itertools
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
CHECKED = ("README.md", "CONTRIBUTING.md", "config", "docs", "workflow", "benchmarks", "tests")
UNCONVERTED: tuple[str, ...] = ()  # patterns of paths
EXAMPLES = ("tests/test_prose.py",)  # forbidden examples
MAX_WORDS = 30  # per sentence
MIN_WORDS = 5  # of a string that is checked as a sentence

# Rule: forbidden pattern, and the term to use.
WORDS = {
    r"(?:told|tells?|telling)\b[^.;:]{0,60}\bapart": "distinguish, discriminate",
    r"own(?:ed|s|ing)? up": "report as unexplained",
    r"left out": "missing",
    r"conceal\w*": "hidden",
    r"h(?:o|e)ld(?:s|ing)?\b[^.;:,]{0,60}\bagainst": "compare with, validate against",
    r"h(?:o|e)ld(?:s|ing)? the truth": "cover the true value",
    r"anew|afresh|once more": "again",
    r"stand-ins?|stands? in for": "alternative, proxy",
    r"ambiguous with": "indistinguishable from",
    r"promised gain|gain (?:that (?:it|is) )?promised|that it promises": "expected improvement",
    r"by the clock": "wall time",
    r"processor time": "CPU time",
    r"(?:is|are|was|were|be|been|being) asked": "name the target or the setting",
    r"moved repeats?": "re-positioned scans",
    r"views? of a number|one view (?:of|in) (?:two|three|four|five|\d+)": "every n-th view",
    r"what matters|matters? in practice": "clinically relevant",
    r"ours": "Virtual Phantom",
    r"rooms?": "packages, modules",
    r"what (?:is|are) of": "name the thing",
    r"stands? beside|beside (?:it|them) stands?": "next to, in the same row",
    r"nobody's": "name it",
    r"turn(?:ed|s)? round": "reverse, mirror",
}
SPELLING = (
    r"colour(?:s|ed|ing)?|grey(?:s|er|ish)?|licences?|behaviours?|favour\w*|neighbour(?:s|ing|hoods?)?|centre[sd]?|"
    r"fibres?|(?:milli|centi|kilo)?metres?|analys(?:e|ed|ing)|label(?:led|ling)|model(?:led|ling)|travel(?:led|ling)|"
    r"(?:normal|linear|discret|optim|initial|summar|recogn|voxel|digit|quant|minim|maxim|general|organ|serial|visual|"
    r"parametr|regular|random|real|standard|character|emphas|memor|special|central|symbol|util|local|equal)is"
    r"(?:e|es|ed|ing|ation|ations|er|ers)"
)
STARTS = {
    r"Of\b": "a sentence does not start with 'Of'",
    r"(?:That|Those) of\b": "a sentence does not start with 'That of', 'Those of'",
}
ABBREVIATIONS = re.compile(
    r"\b(?:e\.g|i\.e|et al|cf|vs|approx|resp|Fig|Figs|Eq|Eqs|Sec|Ref|Refs|No|no|pp|Sci|Rep|Med|Phys|Biol|Proc|Trans|"
    r"IEEE|J|Dr|St|[A-Z])\.(?=\s)"
)
SECTION = re.compile(
    r"(Parameters|Returns|Yields|Raises|Attributes|Notes|References|Examples|See Also|Warnings|Other Parameters|Warns)$"
)

DESCRIPTIONS = ("description", "title", "summary", "meaning", "note")  # keys of YAML files
END = re.compile(r"(?<=[.!?])[)\"']?\s+(?=[\"'(`]?[A-Z0-9`])")  # end of a sentence
COMMAND = re.compile(r">>>|\.\.\.|(?:python|snakemake|virtual-phantom\S*|pytest|make) ")  # lines of a docstring


class Text(NamedTuple):
    """A paragraph, a list item, a table cell, a heading or a message, and the line at which it begins."""

    line: int
    text: str
    docstring: bool = False


class Finding(NamedTuple):
    """A breach of a rule."""

    line: int
    rule: str
    text: str


def markdown(text: str, first: int = 1) -> Iterator[Text]:
    """Paragraphs, list items, headings and table cells of a page. Code, comments and link targets are removed."""
    blank = lambda match: "\n" * match[0].count("\n")  # noqa: E731
    text = re.sub(r"<!--.*?-->", blank, text, flags=re.DOTALL)
    text = re.sub(r"^( *)(```|~~~).*?^\1\2 *$", blank, text, flags=re.DOTALL | re.MULTILINE)
    parts: list[str] = []
    start = first
    for number, line in enumerate([*text.split("\n"), ""], first):
        stripped = re.sub(r"^(?:> ?)+", "", line.strip()).strip()
        begins = re.match(r"(?:[*+-]|\d+[.)])\s+|#+\s|\|", stripped)
        if parts and (not stripped or begins or parts[-1].startswith(("#", "|"))):
            yield from _cells(start, parts)
            parts = []
        if stripped:
            start = start if parts else number
            parts.append(stripped)


def _cells(start: int, parts: list[str]) -> Iterator[Text]:
    text = " ".join(parts)
    if text.startswith("|"):
        yield from (Text(start, cell.strip()) for cell in text.strip("|").split("|") if re.search("[a-z]", cell))
    else:
        yield Text(start, re.sub(r"^(?:[*+-]|\d+[.)])\s+|^#+\s*", "", text))


def docstring(text: str, first: int) -> Iterator[Text]:
    """Paragraphs of a docstring in NumPy style. Names and types of parameters, formulas and examples are removed."""
    parts: list[str] = []
    start, indent, leads, code = first, 0, True, False
    for number, line in enumerate([*inspect.cleandoc(text).split("\n"), ""], first):
        stripped, depth = line.strip(), len(line) - len(line.lstrip())
        entry = re.match(r"[*\w`'\", \[\]]+ : ", stripped) or SECTION.match(stripped) or re.match("[-=]+$", stripped)
        code = code and (not stripped or depth > 0)
        if parts and (not stripped or entry or depth != indent or re.match(r"[*+-] ", stripped)):
            code = code or parts[-1].endswith("::")
            yield Text(start, " ".join(parts), leads)
            parts, leads = [], False
        if stripped and not entry and not code and not COMMAND.match(stripped):
            start, indent = (start, indent) if parts else (number, depth)
            parts.append(stripped)


def python(text: str) -> Iterator[Text]:
    """Docstrings, comments and strings that look like sentences of a module."""
    nodes = list(ast.walk(ast.parse(text)))
    docstrings = {node for node in map(_docstring, nodes) if node}
    for node in docstrings:
        yield from docstring(node.value, node.lineno)
    parts = {
        id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in ast.walk(node) if part is not node
    }
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            yield from message(node.lineno, _text(node))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docstrings:
            yield from () if id(node) in parts else message(node.lineno, node.value)
    yield from comments(_comments(text, [node.end_lineno for node in nodes[0].body]))


def _comments(text: str, ends: list[int]) -> Iterator[tuple[int, int, str]]:
    """Comments (line, column, text). Statements that end in these lines are read only if they contain `#`."""
    lines = text.split("\n")
    for first, last in itertools.pairwise([0, *ends, len(lines)]):
        statement = "\n".join(lines[first:last])
        if "#" in statement:
            for token in tokenize.generate_tokens(io.StringIO(statement).readline):
                if token.type == tokenize.COMMENT:
                    yield first + token.start[0], token.start[1], token.string


def _docstring(node: ast.AST) -> ast.Constant | None:
    if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(node):
        return node.body[0].value
    return None


def _text(string: ast.JoinedStr) -> str:
    """Return an f-string with X for each value."""
    return "".join(part.value if isinstance(part, ast.Constant) else "X" for part in string.values)


def message(line: int, text: str) -> Iterator[Text]:
    """A string, if it reads as a sentence: MIN_WORDS words or more, most of them in lower case."""
    words = text.split()
    plain = [word for word in words if re.fullmatch(r"[a-z]+(?:'[a-z]+)?[,.;:]?", word)]
    if len(words) >= MIN_WORDS and len(plain) > len(words) / 2 and not re.search(r"\\[a-zA-Z]|^\s*<|\bimport \w", text):
        yield from markdown(text, line)


def comments(found) -> Iterator[Text]:
    """Comments (line, column, text). Comments in the same column of consecutive lines are one text."""
    parts: list[str] = []
    start, last, place = 0, -1, -1
    for line, column, text in [*found, (-9, -9, "# end")]:
        content = re.sub(r"^#+:?\s?", "", text).strip()
        if parts and (line != last + 1 or column != place or not content or re.match(r"[*+-] |\d+[.)] ", content)):
            yield Text(start, " ".join(parts))
            parts = []
        if content and not re.match(r"(?:noqa|type:|pragma|fmt:|!)", content):
            start = start if parts else line
            parts.append(content)
        last, place = line, column


def yaml_file(text: str) -> Iterator[Text]:
    """Comments and descriptions of a YAML file."""
    yield from line_comments(text)
    nodes = list(yaml.compose_all(text))
    while nodes:
        node = nodes.pop()
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                nodes.append(value)
                if key.value in DESCRIPTIONS and isinstance(value, yaml.ScalarNode):
                    yield from markdown(value.value, value.start_mark.line + 1)
        elif isinstance(node, yaml.SequenceNode):
            nodes += node.value


def rules(text: str) -> Iterator[Text]:
    """Comments and docstrings of a file of Snakemake rules."""
    yield from line_comments(text)
    for match in re.finditer(r'^ +"""(.*?)"""', text, re.MULTILINE | re.DOTALL):
        yield from docstring(match[1], text[: match.start()].count("\n") + 1)


def line_comments(text: str) -> Iterator[Text]:
    """Comments of a file in which # begins a comment."""
    lines = [(number, re.search(r"(?:^|\s)#(?!\{).*", line)) for number, line in enumerate(text.split("\n"), 1)]
    yield from comments((number, match.start(), match[0].strip()) for number, match in lines if match)


def notebook(text: str) -> Iterator[Text]:
    """Markdown cells of a notebook. All are at line 1."""
    for cell in json.loads(text)["cells"]:
        if cell["cell_type"] == "markdown":
            yield from (part._replace(line=1) for part in markdown("".join(cell["source"])))


def page(text: str) -> Iterator[Text]:
    """Text of a template of a page, between its tags."""
    text = re.sub(r"(?s)<(script|style)\b.*?</\1>|\{#.*?#\}|<!--.*?-->", lambda m: "\n" * m[0].count("\n"), text)
    text = re.sub(r"(?s)\{%.*?%\}", lambda m: "\n" * m[0].count("\n"), re.sub(r"(?s)\{\{.*?\}\}", "X", text))
    text = re.sub(r"</?(?:b|i|em|strong|code|a|span|sub|sup)\b[^>]*>", "", text)
    yield from markdown(re.sub(r"(?s)<[^>]*>", lambda m: "\n\n" if "\n" not in m[0] else m[0].count("\n") * "\n", text))


READERS = {".md": markdown, ".rst": page, ".py": python, ".smk": rules, ".html": page, ".ipynb": notebook}
READERS |= dict.fromkeys((".yaml", ".yml"), yaml_file)


def sentences(text: str) -> Iterator[str]:
    """Sentences of a paragraph. Code, links and formulas count as one word."""
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`+[^`]*`+", "`code`", text))
    text = re.sub(r"https?://\S+", "`code`", text)
    text = ABBREVIATIONS.sub(lambda match: match[0][:-1] + "\0", re.sub(r"[*]{1,2}(?=\S)|(?<=\S)[*]{1,2}", "", text))
    yield from (
        part.replace("\0", ".") for part in re.split(r"(?<=[.!?])[)\"']?\s+(?=[\"'(`]?[A-Z0-9`])", text) if part
    )


def check(text: Text) -> Iterator[Finding]:
    """Apply the rules to a text."""
    if text.docstring and (match := re.match(r"(?:What|Of)\b", text.text)):
        yield Finding(text.line, "docstring", f"starts with {match[0]!r}; name the result: {text.text[:60]}")
    for sentence in sentences(text.text):
        count = sum(bool(re.search(r"[^\W\d]", word)) for word in sentence.split())
        if count > MAX_WORDS:
            yield Finding(text.line, "long", f"{count} words: {sentence}")
        for pattern, why in STARTS.items():
            if re.match(pattern, sentence) and not text.docstring:
                yield Finding(text.line, "start", f"{why}: {sentence[:60]}")
        for pattern, term in WORDS.items():
            for match in re.finditer(rf"\b(?:{pattern})\b", sentence, re.IGNORECASE):
                yield Finding(text.line, "word", f"{match[0]!r}; use: {term}")
        for match in re.finditer(rf"(?<![/_.\w])(?:{SPELLING})(?![/_\w])", sentence, re.IGNORECASE):
            yield Finding(text.line, "spelling", f"{match[0]!r} is not American English")


def _kind(path: Path) -> str:
    """Return the suffix without that of a template. A Snakefile counts as rules."""
    return ".smk" if path.name == "Snakefile" else Path(path.name.removesuffix(".j2")).suffix


def findings(path: Path) -> list[Finding]:
    """Everything that is wrong in a file, by line."""
    reader = READERS[_kind(path)]
    return sorted(finding for text in reader(path.read_text(encoding="utf-8")) for finding in check(text))


def files(places: list[Path]) -> list[Path]:
    """List the files that can be checked: the files named, and those in the folders named."""
    found = [path for place in places for path in ([place] if place.is_file() else sorted(place.rglob("*")))]
    known = [path for path in found if _kind(path) in READERS]
    return [path for path in known if path.is_file() and "__pycache__" not in path.parts]


def converted() -> list[Path]:
    """List the files that must be without findings."""
    skipped = {path for pattern in (*UNCONVERTED, *EXAMPLES) for path in ROOT.glob(pattern)}
    return [path for path in files([ROOT / name for name in CHECKED]) if not skipped & {path, *path.parents}]


def main(arguments: list[str]) -> int:
    """Print the findings of the files or folders named, or of all converted files. Return 1 if there are any."""
    number = 0
    for path in files([Path(name) for name in arguments]) if arguments else converted():
        for finding in findings(path):
            number += 1
            print(f"{path}:{finding.line}: {finding.rule}: {finding.text}")
    return int(number > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
