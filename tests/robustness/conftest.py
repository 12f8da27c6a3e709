"""The folders and files of the recordings' and the phantom's tests serve here too."""

import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS / "phantom"), str(TESTS / "recordings")]


def pytest_terminal_summary(terminalreporter):
    from hostile import outcomes

    for (what, came), number in sorted(outcomes.items()):
        terminalreporter.write_line(f"fuzzed {what}: {number} {came}")
