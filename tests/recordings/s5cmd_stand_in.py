"""Replacement of s5cmd if it is not installed: `run` of a list of `cp --if-size-differ "s3://BUCKET/FOLDER/*" TARGET/`.

A bucket is a folder in BUCKETS. With STOP_AFTER it stops after that number of files, with the next file half written,
as s5cmd leaves it when it is killed. Options, exit codes and error lines are those of s5cmd 2.3.0.
"""

import os
import shlex
import shutil
import sys
from pathlib import Path

OPTIONS = {"--endpoint-url", "--log", "--numworkers", "--retry-count"}


def main(words):
    endpoint = ""
    while words and words[0] != "run":
        option = words.pop(0)
        if option in OPTIONS:
            value = words.pop(0)
            endpoint = value if option == "--endpoint-url" else endpoint
        elif option != "--no-sign-request":
            sys.exit(f"Incorrect Usage: flag provided but not defined: {option}")
    if words != ["run"]:
        sys.exit("no command")
    failed, copied = False, 0
    stop = int(os.environ.get("STOP_AFTER", 10**9))
    for line in filter(None, map(str.strip, sys.stdin)):
        command, flag, source, target = shlex.split(line)
        assert (command, flag) == ("cp", "--if-size-differ") and source.endswith("/*") and target.endswith("/")
        if not endpoint.endswith(os.environ["SERVICE"]):
            print("ERROR session: fetching region failed: RequestError: send request failed", file=sys.stderr)
            print("caused by: dial tcp: connect: connection refused", file=sys.stderr)
            failed = True
            continue
        folder = Path(os.environ["BUCKETS"]) / source.removeprefix("s3://").removesuffix("/*")
        if not folder.is_dir():
            print(f'ERROR "cp {source} {target}": no object found', file=sys.stderr)
            failed = True
            continue
        Path(target).mkdir(parents=True, exist_ok=True)
        for path in sorted(folder.iterdir()):
            place = Path(target) / path.name
            if place.exists() and place.stat().st_size == path.stat().st_size:
                continue
            half = place.with_name(f"{place.name}1234567")
            if copied == stop:
                half.write_bytes(path.read_bytes()[:100])
                print(f'ERROR "cp {source} {place}": RequestError: connection reset by peer', file=sys.stderr)
                sys.exit(1)
            shutil.copyfile(path, half)
            half.rename(place)
            copied += 1
    sys.exit(int(failed))


main(sys.argv[1:])
