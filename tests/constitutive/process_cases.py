"""The law in processes and threads of callers, each case a program of its own: ``python -m process_cases CASE``.

A case prints what it found; `test_processes.py` runs it with a time limit, since what goes wrong here waits for ever.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np

from granfabric.constitutive import threads
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial

POINTS = 3 * threads.FEWEST_POINTS
METHODS = [m for m in ("fork", "forkserver", "spawn") if m in multiprocessing.get_all_start_methods()]


def laws():
    """The contact law, and one whose kernel is compiled in a second."""
    packing = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)
    return ContactLaw([packing]), VonMisesLaw(VonMisesMaterial(1e9, 0.3, 2e5, 1e7))


def arrays(law, number, k=0):
    """Arguments of an update, its outputs full of nines."""
    stress = np.tile([-1e5, -0.9e5, 2e3], (number, 1))
    state = law.initial_state(stress)
    strain = np.tile([1e-6, -3e-6, 2e-6], (number, 1)) * (1.0 + k + np.linspace(0.0, 1.0, number))[:, None]
    return strain, stress, state, np.full_like(stress, 9.0), np.full_like(state, 9.0), np.full((number, 3, 3), 9.0)


def digest(*results):
    """All bits of some arrays."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in results)).hexdigest()[:16]


def work(k):
    """Both laws in as many threads as there are."""
    found = []
    for law in laws():
        a = arrays(law, max(POINTS, 2 * threads.FEWEST_CHEAP_POINTS), k)
        law.update(*a)
        found.append(digest(*a[3:]))
    return found


def host(_):
    """Assembly and files of the host, and the motion of grains in two threads."""
    from granfabric.dem_ref.dynamics.motion import Control, Motion
    from granfabric.dem_ref.sample.disks import new_sample
    from granfabric.fem.discretisation.assembly import FEWEST_ELEMENTS, ForceAssembler, TangentAssembler
    from granfabric.fem.discretisation.space import Space
    from granfabric.fem.mesh.host_mesh import rectangle
    from granfabric.fem.output.vtu import GridWriter

    n = int(np.sqrt(2 * FEWEST_ELEMENTS / 2)) + 2
    space = Space(rectangle(1.0, 1.0, n, n), "P1")
    random = np.random.default_rng(0)
    stress, tangent = random.standard_normal((space.npoints, 3)), random.standard_normal((space.npoints, 3, 3))
    force = ForceAssembler(space).internal_force(stress, np.empty(space.ndofs))
    matrix = TangentAssembler(space, np.arange(space.ndofs)).assemble(tangent)
    with tempfile.TemporaryDirectory() as folder:
        writer = GridWriter(np.zeros((3, 3)), [("triangle", np.array([[0, 1, 2]]))])
        writer.write(Path(folder) / "a.vtu", {"a": np.ones(3)})
        file = (Path(folder) / "a.vtu").read_bytes()
    place = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=2).reshape(-1, 2)
    motion = Motion(new_sample(place * 0.999, np.full(64, 0.5), 7.992 * np.eye(2)), threads=2)
    motion.run(100, Control(drive=np.array([-1e-6, 0.0, 0.0])))
    return [digest(force, matrix.data, motion.sample.position, motion.stress), hashlib.sha256(file).hexdigest()[:16]]


def pools():
    """Processes started in every way after the parent has used its threads, and again from the children's results."""
    mine = [work(k) for k in range(3)], host(0)
    assert threading.active_count() > 1, "the parent used one thread only"
    for method in METHODS:
        with multiprocessing.get_context(method).Pool(2) as pool:
            assert pool.map_async(work, range(3)).get(timeout=100) == mine[0], method
            assert pool.map_async(host, range(2)).get(timeout=100) == [mine[1]] * 2, method
        print(method, "agrees")
    with ProcessPoolExecutor(2) as executor:
        assert list(executor.map(work, range(3))) == mine[0]
    assert work(0) == mine[0][0]
    print("executor agrees")


def with_joblib():
    """joblib's ways to start workers; loky and multiprocessing hand over large arrays as read-only memory maps."""
    from joblib import Parallel, delayed

    mine = [work(k) for k in range(3)]
    for backend in ("loky", "multiprocessing", "threading"):
        assert Parallel(2, backend=backend)(delayed(work)(k) for k in range(3)) == mine, backend
        law = laws()[0]
        a = arrays(law, 20_000)
        both = Parallel(2, backend=backend, max_nbytes=1000)(delayed(from_map)(law, *a[:3]) for _ in range(2))
        law.update(*a)
        assert {text for text, _ in both} == {digest(*a[3:])}, backend
        assert all(number <= 1 for _, number in both), "a second compilation"
        print(backend, "agrees")


def from_map(law, strain, stress, state):
    """An update of arrays that may be read-only maps."""
    from granfabric.constitutive.integration.points import update_points

    ends = np.empty(stress.shape), np.empty(state.shape), np.empty((len(stress), 3, 3))
    law.update(strain, stress, state, *ends)
    return digest(*ends), len(update_points.signatures)


def forked_while_busy():
    """Forks while other threads of the parent update; one child ends through the interpreter's own end."""
    wanted = work(0)
    stop = threading.Event()

    def keep_busy():
        while not stop.is_set():
            work(1)

    busy = [threading.Thread(target=keep_busy) for _ in range(2)]
    for thread in busy:
        thread.start()
    for number in range(6):
        child = os.fork()
        if child == 0:
            right = work(0) == wanted
            if number == 0:
                sys.exit(0 if right else 1)
            os._exit(0 if right else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    stop.set()
    for thread in busy:
        thread.join()
    print("six children agree")


def forked_while_compiling():
    """A fork in the middle of a compilation by another thread; needs an empty cache."""
    law = laws()[1]
    compiler = threading.Thread(target=law.update, args=arrays(law, 2)[:6])
    compiler.start()
    time.sleep(0.3)
    child = os.fork()
    if child == 0:
        law.update(*arrays(law, 2)[:6])
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    compiler.join()
    print("the child compiles, too")


def many_threads():
    """Several threads of the caller, nested in its own pools, each with its own number of threads."""
    wanted = [work(k) for k in range(4)]

    def limited(k):
        numba.set_num_threads(1 + k % 2)
        return work(k)

    def nested(k):
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(work, [k, k]))

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(work, range(4))) == wanted
        assert list(pool.map(limited, range(4))) == wanted
        assert list(pool.map(nested, range(4))) == [[w, w] for w in wanted]
        grains = host(0)
        assert list(pool.map(host, range(6))) == [grains] * 6
    helpers = [t for t in threading.enumerate() if t.name.startswith("granfabric")]
    assert len(helpers) <= max(1, numba.config.NUMBA_NUM_THREADS - 1)
    print("threads agree")


def interrupted():
    """Ctrl-C twice while an update runs: nothing is written afterwards, and the same call gives the same bits."""
    law = laws()[0]
    a = arrays(law, 60_000)
    law.update(*a)
    since = time.perf_counter()
    law.update(*a)
    wanted, seconds = digest(*a[3:]), time.perf_counter() - since
    raised = [0]

    def on_signal(number, frame):
        # as the interpreter's own, but not while the test is looking
        while frame is not None and frame.f_code is not ContactLaw.update.__code__:
            frame = frame.f_back
        if frame is not None:
            raised[-1] += 1
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, on_signal)
    random = np.random.default_rng(0)
    for _ in range(40):
        for end in a[3:]:
            end.fill(9.0)
        raised.append(0)
        # the second one comes while the call waits for its helpers to finish their ranges
        pauses = random.uniform(0.0, 0.6) * seconds, random.uniform(0.0, 0.2) * seconds

        def press(pauses=pauses):
            for pause in pauses:
                time.sleep(pause)
                os.kill(os.getpid(), signal.SIGINT)

        keys = threading.Thread(target=press)
        keys.start()
        try:
            law.update(*a)
            assert not raised[-1], "an interruption was lost"
        except KeyboardInterrupt:
            pass
        after = digest(*a[3:])
        keys.join()
        time.sleep(0.01)
        assert digest(*a[3:]) == after, "written after the call had returned"
        assert law.update(*a).failed == 0
        assert digest(*a[3:]) == wanted
    assert raised.count(1) + raised.count(2) > 10, raised
    print("interrupted", raised.count(1), "times once,", raised.count(2), "times twice")


def cold():
    """A first use, its result and how many kernels were not in the cache."""
    from granfabric.constitutive.plain_laws import von_mises

    law = laws()[1]
    a = arrays(law, 3)
    law.update(*a)
    print(digest(*a[3:]), sum(von_mises._update.stats.cache_misses.values()))


if __name__ == "__main__":
    globals()[sys.argv[1]]()
