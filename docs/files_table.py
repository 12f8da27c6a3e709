"""Write docs/files.md, the list of every file that the workflow makes, from the library's table of outputs.

python docs/files_table.py
"""

from pathlib import Path

from virtual_phantom.config.outputs import OUTPUTS

TARGET = Path(__file__).resolve().parent / "files.md"
INTRODUCTION = """# Every file

Paths are in `results_dir`. A name in braces stands for yours: a protocol, a noise level, a recording. Each line
names the rule that makes the file. Each job has a log in `logs`. Data have their checksums beside them, in hidden files
([what is promised](promises.md)). [What other programs read](outputs.md) says more of the formats.

This page is made from `workflow/lib/virtual_phantom/study/outputs.py` by `docs/files_table.py`.

| file | what it is | rule |
|---|---|---|
"""


def page() -> str:
    """The whole page."""
    rows = []
    for output in OUTPUTS:
        path = output.pattern + (".png, .pdf" if len(output.suffixes) > 1 else "")
        rows.append(f"| `{path}` | {output.what} | `{output.rule}` |")
    return INTRODUCTION + "\n".join(rows) + "\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
