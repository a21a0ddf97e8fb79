#!/usr/bin/env bash
# library: distributed (Dask)
# version: 2026.8.0
# expected: tasks that only wait at a worker, behind one that ends its process each time, are done once that one is given up
# seen: one of them is given up as well, with "Attempted to run task 'aa' on 4 different workers, but all those workers died while
#       running it"; it was never begun. What waits at a lost worker counts as suspect, like what was at work
# Whether a task waits at a worker or at the scheduler hangs on its key: keys of one name and a number wait at the scheduler
# once there are more than twice as many as threads; keys with names of their own are given to workers at once.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q dask==2026.8.0 distributed==2026.8.0
cd "$work"
cat > look.py <<'PY'
import logging
import os
import signal
import time
from pathlib import Path

import dask
import distributed
from distributed import Client, LocalCluster

dask.config.set({"logging.distributed": "critical"})


def ends_its_process():
    time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGKILL)


def leaves_a_mark(name):
    Path(name).touch()
    return name


def outcomes(keys):
    """Killer first, then one task a key, on one worker of one thread; of each its outcome and whether it was begun."""
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        killer = client.submit(ends_its_process, key="killer", priority=10)
        time.sleep(0.2)
        waiting = [client.submit(leaves_a_mark, os.path.abspath(key), key=key) for key in keys]
        said = type(killer.exception()).__name__
        found = []
        for key, future in zip(keys, waiting):
            error = future.exception()
            if error and not Path(key).exists():
                print("said of it:", str(error).split(". ")[0])
            found.append((type(error).__name__ if error else "done", Path(key).exists()))
        return said, found


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    print("distributed", distributed.__version__)
    own, alike = [f"{letter}{letter}" for letter in "abcdef"], [f"task-{n}" for n in range(6)]
    killer, named = outcomes(own)
    print("names of their own:     killer", killer, "| waiting (outcome, begun):", *named)
    killer, numbered = outcomes(alike)
    print("one name and a number:  killer", killer, "| waiting (outcome, begun):", *numbered)
    innocent = [entry for entry in named if entry == ("KilledWorker", False)]
    print(f"{len(innocent)} of {len(named)} tasks that were never begun are said to have ended workers")
    raise SystemExit(0 if innocent and killer == "KilledWorker" else 1)
PY
echo "expected: the waiting tasks are done, only the killer is given up"
"$work/venv/bin/python" look.py
