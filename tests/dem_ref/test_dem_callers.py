"""Random wrong arrays and numbers at the entries of the DEM that lead to compiled kernels: SampleError, or right."""

from __future__ import annotations

import dataclasses
import itertools
import os
import signal
import threading
import time

import numpy as np
import pytest
from dem_samples import triangular_lattice
from hypothesis import given, settings
from hypothesis import strategies as st
from wrong_arrays import COPIED, OUTPUT_REFUSED, REFUSED, SAME

from granfabric.dem_ref.arrays import SampleError
from granfabric.dem_ref.dynamics import relaxation, settling, stepping
from granfabric.dem_ref.dynamics.motion import Control, Motion, UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingOptions, make_packing
from granfabric.dem_ref.dynamics.relaxation import relax
from granfabric.dem_ref.dynamics.settling import settle
from granfabric.dem_ref.ensemble import for_seeds
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import RunOptions
from granfabric.dem_ref.loading.servo import RateLimits
from granfabric.dem_ref.sample import neighbours
from granfabric.dem_ref.sample.disks import Sample, new_sample
from granfabric.dem_ref.sample.neighbours import NearPairs, find_near_pairs

FEW = settings(max_examples=150, deadline=None, database=None, derandomize=True)
KERNELS = (
    neighbours._fill_pairs,
    neighbours._carry_over,
    relaxation._relax,
    settling._settle,
    stepping.refresh_contacts,
    stepping.write_back,
    stepping.advance,
)
STIFFNESS = 1024.0
DRIVE = np.array([-1e-4, 0.0, 0.0])


def lattice():
    return triangular_lattice(6, 6, 2.0**-7, STIFFNESS)


def coarse(sample):
    """Its arrays with numbers that a float16 holds, so that another kind of number is the same number."""
    position = np.round(sample.position * 64) / 64
    return {"position": position, "radius": sample.radius, "cell": np.round(sample.cell * 64) / 64}


def signatures():
    return [len(kernel.signatures) for kernel in KERNELS]


def moved(sample):
    """Everything that a short motion leaves."""
    motion = Motion(sample)
    motion.run(20, Control(drive=DRIVE.copy()))
    return [sample.position, sample.velocity, sample.spin, sample.cell, sample.pairs.tangential, motion.stress]


@pytest.fixture(scope="module", autouse=True)
def compiled():
    moved(lattice())
    relax(*(np.array(a) for a in coarse(lattice()).values()), 1e-3, steps=3)
    settle(*(np.array(a) for a in coarse(lattice()).values()), 1e-3, steps=3)
    return signatures()


@FEW
@given(data=st.data())
def test_disks(data, compiled):
    """Arrays of `new_sample` and `find_near_pairs`."""
    good = coarse(lattice())
    name = data.draw(st.sampled_from(list(good)))
    variant = data.draw(st.sampled_from([*COPIED, *REFUSED, "NaN", "infinity", "far away", "nothing at all"]))
    wrong = {
        "NaN": lambda a: np.full_like(a, np.nan),
        "infinity": lambda a: np.full_like(a, np.inf),
        "far away": lambda a: a * 1e30 if name == "position" else -a[::-1].copy(),
        "nothing at all": lambda a: np.zeros_like(a) if name != "position" else a[:0],
    }
    value = {**REFUSED, **wrong, **COPIED}[variant](good[name])
    if value is SAME or (variant in ("int64", "broadcast") and name != "position"):
        return
    arguments = {**good, name: value}
    for entry in (new_sample, lambda **given: find_near_pairs(**given, skin=0.05)):
        if variant in COPIED:
            made, again = entry(**arguments), entry(**{**good, name: np.array(np.asarray(value).tolist())})
            made, again = (getattr(m, "pairs", m) for m in (made, again))
            for field in ("first", "second", "image"):
                assert np.array_equal(getattr(made, field), getattr(again, field))
        else:
            with pytest.raises(ValueError):
                entry(**arguments)
    assert signatures() == compiled


@FEW
@given(data=st.data())
def test_a_sample_whose_arrays_were_exchanged(data, compiled):
    """Every array of a sample can be reached from outside; a motion takes what it can use, and refuses the rest."""
    sample = lattice()
    motion = Motion(sample)
    motion.run(10, Control(drive=DRIVE.copy()))
    other = sample.copy()
    names = ["position", "radius", "cell", "strain_rate", "strain", "velocity", "spin"]
    name = data.draw(st.sampled_from([*names, "stress", "tally", "measures"]))
    holder = sample if name in names else motion
    same = ("Fortran order", "strided", "backwards", "read-only", "misaligned", "memory map")
    taken = {n: COPIED[n] for n in same}
    refused = OUTPUT_REFUSED if holder is motion else REFUSED
    variant = data.draw(st.sampled_from([*taken, *refused] if holder is sample else list(refused)))
    value = {**refused, **(taken if holder is sample else {})}[variant](getattr(holder, name))
    if value is SAME:
        return
    setattr(holder, name, value)
    if variant in refused:
        with pytest.raises(SampleError, match=name):
            motion.run(10, Control(drive=DRIVE.copy()))
    else:
        motion.run(10, Control(drive=DRIVE.copy()))
        expected = Motion(lattice())
        expected.run(20, Control(drive=DRIVE.copy()))
        assert np.array_equal(sample.position, expected.sample.position)
        assert np.array_equal(motion.stress, expected.stress)
    assert other.position.shape == (36, 2)
    assert signatures() == compiled


@pytest.mark.parametrize("name", ["first", "second", "image", "tangential"])
def test_pairs_that_name_no_disk(name):
    """An index beyond the disks was read from behind the array, and a segmentation fault at some size."""
    for change in (
        lambda a: a[:-1],
        lambda a: a + (10**6 if a.dtype == np.uint32 else 100),
        lambda a: a.astype(float) * 1j,
        lambda a: a.astype(str),
        lambda a: None,
    ):
        sample = lattice()
        value = change(getattr(sample.pairs, name))
        harmless = name in ("image", "tangential") and isinstance(value, np.ndarray) and value.shape == (
            getattr(sample.pairs, name).shape
        ) and value.dtype.kind in "if"  # fmt: skip
        arrays = {f.name: getattr(sample.pairs, f.name) for f in dataclasses.fields(NearPairs)}
        pairs = NearPairs(**{**arrays, name: value})
        motion = Motion(sample)
        motion.run(5)
        sample.pairs = pairs
        if harmless:
            motion.run(5)  # the list is made anew; springs are those given
            continue
        with pytest.raises(SampleError):
            motion.run(5)
        with pytest.raises(SampleError):
            find_near_pairs(sample.position, sample.radius, sample.cell, 0.03, pairs)
        with pytest.raises(SampleError):
            dataclasses.replace(lattice(), pairs=pairs)


def test_a_list_of_somebody_else_is_made_anew():
    """Pairs left out of an exchanged list are found again: contacts that are missing change forces without a word."""
    sample, other = lattice(), lattice()
    motion, expected = Motion(sample), Motion(other)
    for one in (motion, expected):
        one.run(10, Control(drive=DRIVE.copy()))
    p = sample.pairs
    sample.pairs = NearPairs(p.first[:0], p.second[:0], p.image[:0], p.tangential[:0])
    motion.run(1)
    assert len(sample.pairs.first) == len(other.pairs.first)


@pytest.mark.parametrize("name", ["drive", "gain", "target", "target_rate", "fastest_rate"])
@pytest.mark.parametrize("variant", [*REFUSED, "NaN", "list", "float32", "read-only", "strided"])
def test_controls(name, variant, compiled):
    good = np.zeros((3, 3)) if name == "gain" else np.zeros(3)
    value = {**REFUSED, **COPIED, "NaN": lambda a: np.full_like(a, np.nan)}[variant](good)
    if name == "fastest_rate":
        value = {"list": 1, "float32": np.float32(1.0), "strided": 0, "number": -1.0}.get(variant, value)
    if name == "fastest_rate" and variant == "one row for all":
        return  # a number
    motion = Motion(lattice())
    control = Control(**{name: value})
    if variant in COPIED and not (name == "fastest_rate" and variant == "read-only"):
        motion.run(3, control)
    else:
        with pytest.raises(SampleError, match=name):
            motion.run(3, control)
    assert signatures() == compiled


@pytest.mark.parametrize("move", [relax, settle])
@pytest.mark.parametrize("name", ["position", "radius", "cell"])
def test_relaxation_changes_in_place_or_refuses(name, move, compiled):
    good = coarse(lattice())
    variants = REFUSED if name == "radius" else OUTPUT_REFUSED
    for make in variants.values():
        value = make(good[name])
        if value is SAME:
            continue
        arrays = {key: array.copy() for key, array in good.items()}
        before = {key: array.copy() for key, array in arrays.items()}
        with pytest.raises(SampleError, match=name):
            move(**{**arrays, name: value}, pressure=1e-3, steps=3)
        assert all(np.array_equal(arrays[key], before[key]) for key in arrays)
    for make in COPIED.values() if name == "radius" else ():
        if make(good[name]) is SAME or make is COPIED["int64"]:
            continue
        move(**{**{k: a.copy() for k, a in good.items()}, name: make(good[name])}, pressure=1e-3, steps=3)
    room = np.zeros((36 + 2, 2))
    with pytest.raises(SampleError, match="share memory"):
        room[:36], room[34:36] = good["position"], good["cell"]
        move(room[:36], good["radius"], room[34:36], 1e-3, steps=3)
    assert signatures() == compiled


SILLY = [np.nan, -1.0, 1e301, None, "1", True, 1j, [1.0], np.zeros(2), 10**400, object()]


def test_silly_numbers():
    for kind in (PackingOptions, RateLimits):
        for field in dataclasses.fields(kind):
            for value in SILLY:
                if value is None and field.default is None:
                    continue  # not given
                with pytest.raises(SampleError):
                    kind(**{field.name: value}).check()
    with pytest.raises(SampleError, match="chunk"):
        RateLimits(chunk=40.5).check()
    for name in ("normal_stiffness", "stiffness_ratio", "friction"):
        for value in SILLY:
            with pytest.raises(SampleError):
                new_sample(**coarse(lattice()), **{name: value})
    for name in ("step", "damping", "skin", "refresh", "threads"):
        for value in SILLY:
            if not (name == "threads" and (value is True or value is None)):
                with pytest.raises(SampleError):
                    Motion(lattice(), **{name: value})
    for value in SILLY:
        with pytest.raises(SampleError):
            Motion(lattice()).run(value)
        with pytest.raises(SampleError):
            make_packing(100, value)
        with pytest.raises(SampleError):
            make_packing(value, 1)
        with pytest.raises(SampleError):
            lattice().rotated("x" if isinstance(value, float) and value == -1.0 else value)
        with pytest.raises(SampleError):
            lattice().with_friction(value)
        if value is not True:
            with pytest.raises(SampleError):
                for_seeds(str, [1], value)
    for wrong in (None, "sample", {}):
        with pytest.raises(SampleError):
            Motion(wrong)


def test_whole_numbers_do_not_compile_again(compiled):
    """A stiffness, a friction or a damping written without a point was another type for the compiler."""
    sample = lattice()
    whole = Sample(
        sample.position, sample.radius, sample.cell, 1024, 1, 0, sample.velocity, sample.spin, sample.pairs
    )  # fmt: skip
    Motion(whole, damping=0).run(np.int64(3), Control(fastest_rate=1))
    relax(*(np.array(a) for a in coarse(lattice()).values()), 0, steps=3, fixed_cell=1)
    settle(*(np.array(a) for a in coarse(lattice()).values()), 0.01, steps=np.int64(3), drag=0)
    find_near_pairs(sample.position, sample.radius, sample.cell, 0)
    assert signatures() == compiled


def test_disks_too_many_cells_apart():
    """An image is stored in eight bits; further away it would have wrapped around to another one."""
    sample = lattice()
    sample.position[0] += 100 * sample.cell[0]
    near = find_near_pairs(sample.position, sample.radius, sample.cell, 0.0)
    assert len(near.first) == 108
    sample.position[0] += 200 * sample.cell[0]
    with pytest.raises(SampleError, match="cells apart"):
        find_near_pairs(sample.position, sample.radius, sample.cell, 0.0)


def test_a_motion_that_lost_itself_never_reaches_the_search():
    """Positions that are not finite have no bin; the search wrote before the beginning of its arrays."""
    sample = lattice()
    motion = Motion(sample)
    motion.run(2)
    sample.position[3] = np.nan
    motion._room = -1.0
    with pytest.raises(UnstableMotionError, match="lost its stability"):
        motion.run(2)


@pytest.fixture
def interruptible():
    """Ctrl-C is heard: a job in the background of a shell is started with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_motion_is_whole():
    """Ctrl-C between the steps and what belongs to them: springs are those of the steps taken, so that it can go on."""
    drive = np.array([-2e-6, 1e-6, 3e-6])
    caught = 0
    for number in range(20):
        sample = triangular_lattice(12, 12, 2.0**-7, STIFFNESS)
        motion = Motion(sample, refresh=1e-6)

        heard = threading.Event()

        def press(heard=heard, pause=0.002 + 0.001 * number):
            time.sleep(pause)
            os.kill(os.getpid(), signal.SIGINT)
            while not heard.wait(0.5):  # Python may lose an interruption, within a callback of its memory management
                os.kill(os.getpid(), signal.SIGINT)

        keys = threading.Thread(target=press)
        try:
            keys.start()
            # to and fro: however late the key comes, the cell keeps its shape
            for turn in itertools.cycle((1.0, -1.0)):
                motion.run(2000, Control(drive=turn * drive))
        except KeyboardInterrupt:
            heard.set()
            caught += 1
        keys.join()
        whole, rest = divmod(motion.steps_done, 2000)
        expected = Motion(triangular_lattice(12, 12, 2.0**-7, STIFFNESS), refresh=1e-6)
        for steps, turn in zip([2000] * whole + [rest], itertools.cycle((1.0, -1.0))):
            expected.run(steps, Control(drive=turn * drive))
        assert np.array_equal(motion.sample.velocity, expected.sample.velocity)
        for one in (motion, expected):
            one.run(50, Control(drive=drive.copy()))
        assert np.array_equal(motion.stress, expected.stress)
        assert np.array_equal(sample.pairs.tangential, expected.sample.pairs.tangential)
    assert caught == 20


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name in ("shear_strain", "pressure", "angle") for value in (np.nan, np.inf, "a", None, True)]
    + [("stress_ratio", np.nan), ("stress_ratio", "a")],
)
def test_numbers_of_a_segment_are_finite(name, value):
    # a stress ratio of NaN is never reached: the leg went on to its largest strain and said nothing
    with pytest.raises(SampleError, match=f"{name} of a segment is .*, not a finite number"):
        Segment(**{name: value})


def test_segments_that_can_be_read_once_are_kept():
    leg = Segment("mixed", control=iter(("strain",) * 3), target=iter((1e-5, -1e-5, 0.0)))
    assert leg == Segment("mixed", control=("strain",) * 3, target=(1e-5, -1e-5, 0.0))
    assert RunOptions(segments=iter([leg, leg])) == RunOptions(segments=(leg, leg)) == RunOptions(segments=[leg, leg])
    assert RunOptions(segments=leg) == RunOptions(segments=(leg,))
    with pytest.raises(SampleError, match="a run consists of segments, of the class Segment, not of 3"):
        RunOptions(segments=[3])


def test_no_two_kernels_share_stored_code():
    """What is stored under one name would be loaded for the other: code for several threads where one is wanted."""
    kernels = (*KERNELS, stepping.advance_two_threads, settling._settle_two_threads)
    places = {(kernel._cache.cache_path, kernel.py_func.__qualname__) for kernel in kernels}
    assert len(places) == len(kernels)
