import os
import sys

# Python starts hundreds of times in these tests: each time it would compile the library, were its bytecode not kept.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
