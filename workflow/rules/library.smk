"""Put the library on the path and set up the console. This file is included before all others."""

import gc
import os
import sys
import tempfile
from pathlib import Path

from snakemake.logging import logger

# Snakemake makes hundreds of objects per job and keeps them. Python would search them for garbage all the time.
gc.set_threshold(200_000, 50, 50)

# Folder of the rules, which does not depend on the working folder or on the Snakefile that uses them.
RULES = workflow.current_basedir.get_path_or_uri(secret_free=True)
if not os.path.isdir(RULES):
    sys.exit(
        f"Error: {RULES}: the rules need the library next to them; clone the repository and pass the path of its "
        "workflow/Snakefile"
    )
LIBRARY = str(Path(RULES).parent / "lib")
# Use the library next to the rules, even if another version is installed. Scripts run in separate processes and find it
# by PYTHONPATH. The rules need sys.path, since Snakemake adds only the folders of Snakefiles.
sys.path.insert(0, LIBRARY)
os.environ.update(
    PYTHONPATH=os.pathsep.join([LIBRARY, *filter(None, [os.environ.get("PYTHONPATH")])])
)
# Snakemake uses these variables unchecked. tempfile.gettempdir() returns a folder that is writable.
os.environ.update(
    dict.fromkeys({"TMPDIR", "TMP"} & os.environ.keys(), tempfile.gettempdir())
)

from virtual_phantom.base.console import show_any_character
from virtual_phantom.study.progress.startup import install_startup_handler

show_any_character()
if workflow.is_main_process:
    install_startup_handler(logger, workflow.output_settings)
