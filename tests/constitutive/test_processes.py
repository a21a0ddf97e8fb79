"""The law in processes and threads that its callers make: answers, the same bits, and nobody waits for ever."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import numba
import pytest

from granfabric.constitutive.threads import run_in_threads

HERE = Path(__file__).resolve().parent
HOME = HERE.parent.parent


def start(case, **environment):
    """A case of `process_cases` under way, with two threads."""
    paths = [str(HERE), str(HOME), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "NUMBA_NUM_THREADS": "2", **environment}
    return subprocess.Popen(
        [sys.executable, "-m", "process_cases", case],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process, seconds=150):
    """Its output; a case that failed or hangs fails the test with what it said."""
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        out, err = process.communicate()
        pytest.fail(f"no answer within {seconds} s: {out} {err}")
    assert process.returncode == 0, out + err
    return out


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")


def test_processes_of_every_kind_agree():
    assert "executor agrees" in finish(start("pools"))


def test_joblib():
    pytest.importorskip("joblib")
    assert "threading agrees" in finish(start("with_joblib"))


@needs_fork
def test_a_fork_while_threads_are_at_work():
    assert "six children agree" in finish(start("forked_while_busy"))


@needs_fork
def test_a_fork_while_a_thread_compiles(tmp_path):
    assert "the child compiles" in finish(start("forked_while_compiling", NUMBA_CACHE_DIR=str(tmp_path)))


@pytest.mark.parametrize("layer", ["default", "workqueue"])
def test_threads_of_the_caller(layer):
    """The pool that numba falls back to ends the process if two threads call it at once."""
    assert "threads agree" in finish(start("many_threads", NUMBA_THREADING_LAYER=layer))


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_call_that_is_interrupted():
    assert "interrupted" in finish(start("interrupted"))


def test_first_uses_at_once_with_an_empty_cache(tmp_path):
    """Several processes compile and store the same kernels at the same time; a later one finds them."""
    first = [finish(process) for process in [start("cold", NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(3)]]
    results = {text.split()[0] for text in first}
    later = finish(start("cold", NUMBA_CACHE_DIR=str(tmp_path))).split()
    assert results == {later[0]}
    assert later[1] == "0"


def test_an_error_in_one_range_waits_for_the_others():
    """The first error is raised once nobody works any more; ranges not begun are left."""
    running, begun, lock = [0], [], threading.Lock()

    def kernel(first, end):
        with lock:
            running[0] += 1
            begun.append(first)
        time.sleep(0.02)
        with lock:
            running[0] -= 1
        if first == 0:
            raise ArithmeticError("range 0")

    if numba.get_num_threads() < 2:
        pytest.skip("one thread only")
    with pytest.raises(ArithmeticError, match="range 0"):
        run_in_threads(kernel, 1000, (), fewest=100)
    assert running[0] == 0
    time.sleep(0.1)
    assert running[0] == 0
    assert len(begun) < 4 * numba.get_num_threads()


def test_no_more_threads_than_asked_for():
    """Each range once, on no more threads than numba may use."""
    done, names, lock = [], set(), threading.Lock()

    def kernel(first, end, mark):
        with lock:
            done.append((first, end))
            names.add(threading.get_ident())
        time.sleep(0.002)
        assert mark == "x"

    before = numba.get_num_threads()
    try:
        for threads in range(1, before + 1):
            numba.set_num_threads(threads)
            done.clear()
            names.clear()
            run_in_threads(kernel, 1001, ("x",), fewest=10)
            assert len(names) <= threads
            done.sort()
            assert done[0][0] == 0 and done[-1][1] == 1001
            assert all(one[1] == other[0] for one, other in pairwise(done))
    finally:
        numba.set_num_threads(before)
