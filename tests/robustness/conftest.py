"""The folders and files of the recordings' and the phantom's tests serve here too."""

import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS / "phantom"), str(TESTS / "recordings")]
