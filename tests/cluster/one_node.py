"""A real SLURM of one node on this machine: munge, controller and node daemon in a folder of their own.

Needs Debian's slurm-wlm and munge (`apt-get install -y slurm-wlm munge`) and root, but no systemd, cgroups or database:
the controller remembers every job. Snakemake's plugin removes SLURM's variables, SLURM_CONF among them, from the
environment. The configuration must therefore be at SLURM's default path: the folder is mounted on /etc/slurm in a
private mount namespace.
"""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

PROGRAMS = ("munged", "mungekey", "slurmctld", "slurmd", "sbatch", "squeue", "scancel", "scontrol", "sinfo")
CONFIGURED = Path("/etc/slurm")
PRETENDED_GPUS = ("/dev/null", "/dev/zero")
MARK = "ONE_NODE_IN_OWN_MOUNTS"
CONFIGURATION = """
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmdPort={node_port}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerParameters=sched_min_interval=100000
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
MpiDefault=none
SwitchType=switch/none
MinJobAge=43200
ReturnToService=2
GresTypes=gpu
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory={memory} Gres=gpu:{gpus} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def in_own_mounts():
    """Restart this program in a private mount namespace; returns there."""
    if os.environ.get(MARK) is None:
        if os.geteuid() != 0:
            raise SystemExit("munge and SLURM are started for all users here: run this as root")
        os.environ[MARK] = "1"
        os.execvp("unshare", ["unshare", "--mount", sys.executable, *sys.argv])


@contextlib.contextmanager
def one_node(folder: Path):
    """Environment variables with which commands find the cluster while the context lasts."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing:
        raise SystemExit(f"{', '.join(missing)} not found; apt-get install -y slurm-wlm munge")
    if os.environ.get(MARK) is None:
        raise SystemExit("call in_own_mounts() first")
    for name in ("state", "spool"):
        (folder / name).mkdir(parents=True)
    host = socket.gethostname().split(".")[0]
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20 - 512
    controller_port, node_port = _free_ports(2)
    (folder / "slurm.conf").write_text(
        CONFIGURATION.format(
            host=host,
            folder=folder,
            controller_port=controller_port,
            node_port=node_port,
            cores=len(os.sched_getaffinity(0)),
            memory=memory,
            gpus=len(PRETENDED_GPUS),
        )
    )
    # Ordinary files instead of devices: SLURM only counts them.
    gpus = "".join(f"NodeName={host} Name=gpu File={file}\n" for file in PRETENDED_GPUS)
    (folder / "gres.conf").write_text(gpus)
    (folder / "cgroup.conf").write_text("CgroupAutomount=no\nConstrainCores=no\nConstrainRAMSpace=no\n")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("SLURM")}
    CONFIGURED.mkdir(parents=True, exist_ok=True)
    _run(["mount", "--bind", folder, CONFIGURED], environment)
    _run(["mungekey", "--create", "--keyfile", folder / "munge.key"], environment)
    with contextlib.ExitStack() as stack:
        names = {name: f"{folder}/munge.{name}" for name in ("socket", "key", "pid", "log", "seed")}
        munge = ["munged", "--foreground", "--force", f"--socket={names['socket']}", f"--key-file={names['key']}"]
        munge += [f"--pid-file={names['pid']}", f"--log-file={names['log']}", f"--seed-file={names['seed']}"]
        stack.enter_context(_daemon(munge, folder / "munged.out", environment))
        _wait(lambda: Path(names["socket"]).exists(), "munged's socket")
        stack.enter_context(_daemon(["slurmctld", "-D"], folder / "slurmctld.out", environment))
        stack.enter_context(_daemon(["slurmd", "-D"], folder / "slurmd.out", environment))
        _wait(lambda: "idle" in _run(["sinfo", "-h", "-o", "%T"], environment, check=False), "an idle node", folder)
        try:
            yield environment
        finally:
            _run(["scancel", "--user=root"], environment, check=False)
            _wait(lambda: not running(environment), "the last jobs to end", folder)


def jobs(environment: dict) -> list[dict]:
    """All jobs so far.

    Each has an id, a state, `gpus` (the request as SLURM writes it), a comment (the rules that Snakemake names), and
    the seconds of waiting and running.
    """
    columns = "JobID:|,State:|,SubmitTime:|,StartTime:|,EndTime:|,tres-per-job:|,Comment:200"
    found = []
    for line in _run(["squeue", "-h", "-t", "all", "-O", columns], environment).splitlines():
        number, state, submitted, started, ended, gpus, comment = (part.strip() for part in line.split("|", 6))
        times = {"waited": _between(submitted, started), "run": _between(started, ended)}
        found.append({"id": int(number), "state": state, "gpus": gpus, "comment": comment} | times)
    return sorted(found, key=lambda job: job["id"])


def running(environment: dict) -> list[int]:
    """Jobs that wait, run or are being completed."""
    return [int(line) for line in _run(["squeue", "-h", "-o", "%A"], environment).split()]


def _between(start, end):
    try:
        begin, finish = (time.mktime(time.strptime(text, "%Y-%m-%dT%H:%M:%S")) for text in (start, end))
    except ValueError:
        return None
    return finish - begin


def _run(command, environment, check=True):
    done = subprocess.run(list(map(str, command)), env=environment, capture_output=True, text=True, timeout=60)
    if check and done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
    return done.stdout


@contextlib.contextmanager
def _daemon(command, output, environment):
    """Run a program in the foreground of a new session and end it with the context."""
    with open(output, "w", encoding="utf-8") as file:
        process = subprocess.Popen(command, env=environment, stdout=file, stderr=file, start_new_session=True)
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _wait(happened, what, folder=None, seconds=60):
    until = time.monotonic() + seconds
    while not happened():
        if time.monotonic() > until:
            where = f"; see {folder}/*.out" if folder else ""
            raise SystemExit(f"waited {seconds} s for {what} in vain{where}")
        time.sleep(0.5)


def _free_ports(count):
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [socket.getsockname()[1] for socket in sockets]
