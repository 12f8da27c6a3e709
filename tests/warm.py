"""A Python with imported packages: each run is forked from one process, which takes 0.01 s instead of 1 to 2 s.

`python()` is a program that takes `-m snakemake ...` and `script.py ...` like Python, also in the jobs that such a run
of Snakemake starts. No module of this project is imported before the fork. A run whose variables for Python or numba
differ from those of the tests gets a separate Python.
"""

import atexit
import contextlib
import gc
import importlib
import marshal
import os
import runpy
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from functools import cache
from pathlib import Path

# Packages that most runs load: first those of Snakemake, then those of jobs.
IMPORTED = (
    "h5py",
    "jsonschema",
    "numpy",
    "snakemake.cli",
    "snakemake.report.html_reporter",
    "snakemake.script",
    "xraylib",
    "yaml",
    "fontTools.subset",
    "matplotlib.pyplot",
    "nibabel",
    "numba",
    "pandas",
    "radiomics.featureextractor",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.signal",
    "scipy.special",
    "scipy.stats",
    "skimage.measure",
    "sklearn.decomposition",
    "sklearn.discriminant_analysis",
    "sklearn.model_selection",
    "threadpoolctl",
)
# Variables that configure Python and packages when they are loaded.
LOADED_WITH = ("NUMBA_", "PYTHON", "MPL", "ITK_", "LD_")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PATH = [*sys.path]
CLIENT = """
import marshal, os, socket, sys
place, python, *words = sys.argv[1:]
with socket.socket(socket.AF_UNIX) as here:
    here.connect(place)
    content = marshal.dumps((words, os.getcwd(), dict(os.environ)))
    socket.send_fds(here, [len(content).to_bytes(8, "big")], [0, 1, 2])
    here.sendall(content)
    code = here.recv(8)
if code == b"no":
    os.execv(python, [python, *words])
os._exit(int(code or 1))
"""


@cache
def programs():
    """Folder with `python` and `snakemake`."""
    folder = Path(tempfile.mkdtemp(prefix="warm-"))
    client, place = folder / "client.py", folder / "socket"
    client.write_text(CLIENT)
    start = f'exec "{sys.executable}" -IS "{client}" "{place}" "{sys.executable}"'
    for name, words in (("python", ""), ("snakemake", "-m snakemake")):
        (folder / name).write_text(f'#!/bin/sh\n{start} {words} "$@"\n')
        (folder / name).chmod(0o755)
    command = [sys.executable, __file__, str(folder / "python"), str(place)]
    environment = os.environ | dict.fromkeys(THREADS, "1")
    serving = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert serving.stdout.readline() == b"ready\n"
    atexit.register(serving.communicate)  # ends with its input
    return folder


def python():
    """Program that starts like Python."""
    return str(programs() / "python")


def serves(words, environment):
    """Whether a run can be forked."""
    if words[0] != "-m" and words[0].startswith("-"):
        return False

    def loaded_with(variables):
        return {
            name: value
            for name, value in variables.items()
            if name.startswith(LOADED_WITH) and name != "PYTHONPATH" and name != "NUMBA_NUM_THREADS"
        }

    return loaded_with(environment) == loaded_with(os.environ)


def become(program, words, cwd, environment, files):
    """Continue as a Python that was started with these arguments, to its end."""
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    before = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    added = [os.path.join(cwd, path) for path in environment.get("PYTHONPATH", "").split(os.pathsep) if path]
    os.chdir(cwd)
    threads = environment.get(THREADS[0], str(os.cpu_count()))
    os.environ.clear()
    os.environ.update(environment)
    if threads != "1":
        sys.modules["threadpoolctl"].threadpool_limits(int(threads))
    sys.executable = program
    module = words[0] == "-m"
    first = cwd if module else os.path.dirname(os.path.abspath(words[0]))
    sys.path[:] = [first, *added, *(path for path in PATH[1:] if path not in before)]
    sys.argv = words[1:] if module else words
    run = runpy.run_module if module else runpy.run_path
    try:
        run(sys.argv[0], run_name="__main__", **({"alter_sys": True} if module else {}))
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if not isinstance(end.code, int | None):
            print(end.code, file=sys.stderr)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    # Like multiprocessing for forked processes: a normal exit would free all imports and thus write to all of their
    # memory.
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code & 255)


def received(connection):
    """File descriptors and the request."""
    head, files, _, _ = socket.recv_fds(connection, 8, 3)
    content = b""
    while len(content) < int.from_bytes(head, "big"):
        content += connection.recv(1 << 16)
    return files, *marshal.loads(content)


def serve(program, place):
    """Fork for every connection and answer with the exit code of the fork. Ends with its input."""
    for name in IMPORTED:
        importlib.import_module(name)
    sys.modules["snakemake.cli"].get_argument_parser()  # finds the plugins, which are imported
    numba = importlib.import_module("numba.core.registry").cpu_target
    for context in (numba.typing_context, numba.target_context):
        context.refresh()  # what Numba knows of Python and NumPy: needed before it loads a compiled function
    gc.freeze()
    waiting, running = selectors.DefaultSelector(), {}
    woken, wake = socket.socketpair()
    wake.setblocking(False)
    signal.set_wakeup_fd(wake.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(place)
    listening.listen(64)
    for one in (sys.stdin, listening, woken):
        waiting.register(one, selectors.EVENT_READ)
    print("ready", flush=True)
    while True:
        for (one, *_), _ in waiting.select():
            if one is sys.stdin:
                shutil.rmtree(Path(place).parent)
                return
            if one is listening:
                connection = listening.accept()[0]
                files, words, cwd, environment = received(connection)
                if not serves(words, environment):
                    connection.send(b"no")
                    connection.close()
                elif process := os.fork():
                    running[process] = connection
                    waiting.register(connection, selectors.EVENT_READ, process)
                else:
                    signal.set_wakeup_fd(-1)
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    for descriptor in (waiting, listening, connection, woken, wake, *running.values()):
                        descriptor.close()
                    become(program, words, cwd, environment, files)
                for file in files:
                    os.close(file)
            elif one is woken:
                woken.recv(1 << 10)
                for process in [*running]:
                    done, status = os.waitpid(process, os.WNOHANG)
                    if done:
                        connection = running.pop(process)
                        if connection in waiting.get_map():
                            waiting.unregister(connection)
                        code = os.waitstatus_to_exitcode(status)
                        with connection, contextlib.suppress(BrokenPipeError):
                            connection.sendall(str(code if code >= 0 else 128 - code).encode())
            else:  # the client was killed
                for process in [number for number, connection in running.items() if connection is one]:
                    waiting.unregister(one)
                    os.kill(process, signal.SIGTERM)


if __name__ == "__main__":
    serve(*sys.argv[1:])
