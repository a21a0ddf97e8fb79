"""Compiled kernels are made once a machine, by whichever worker comes first; the others wait and load them.

Numba keeps them on disk, but processes that begin together find nothing there and all compile the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from contextlib import nullcontext, suppress
from pathlib import Path

from granfabric.constitutive.compilation import cache_directory
from granfabric.dem_ref.compilation import kernel_cache_directory

from .machine import alone_on_machine, sources

_ready: set[str] = set()
"""Groups that this process need not ask about any more."""


def _mean_field() -> None:
    from granfabric.constitutive.warm_up import warm_up

    warm_up("mean_field")


def _shifted_distribution() -> None:
    from granfabric.constitutive.warm_up import warm_up

    warm_up("shifted_distribution")


def _host() -> None:
    from granfabric.fem.warm_up import warm_up

    warm_up()


def _dem() -> None:
    """The smallest packing: made, measured, and loaded a little."""
    from granfabric.dem_ref.inputs.material import measure_material
    from granfabric.dem_ref.inputs.probes import ProbeError
    from granfabric.dem_ref.loading.path import Segment
    from granfabric.dem_ref.loading.run import DemRun, RunOptions
    from granfabric.dem_ref.preparation.compaction import make_packing
    from granfabric.dem_ref.sample.disks import SampleError

    sample = make_packing(50, 1)
    with suppress(ProbeError, SampleError):  # of so few disks
        measure_material(sample)
    DemRun(sample, RunOptions((Segment("biaxial", shear_strain=1e-5),))).execute()


GROUPS: dict[str, Callable[[], None]] = {
    "mean_field": _mean_field,
    "shifted_distribution": _shifted_distribution,
    "host": _host,
    "dem": _dem,
}
"""What is called to have a group of kernels compiled."""


def mark(group: str) -> Path:
    """File that says that a group is in the disk cache, compiled for the processor of this machine."""
    from llvmlite.binding import get_host_cpu_name

    folder = kernel_cache_directory() if group == "dem" else cache_directory("constitutive")
    return folder / f".compiled-{group}-{get_host_cpu_name()}-{sources()}"


def missing(groups: Iterable[str]) -> list[str]:
    """Those groups that have to be compiled on this machine first."""
    return [group for group in groups if not mark(group).is_file()]


def make_ready(groups: Iterable[str]) -> list[str]:
    """See that groups of kernels are in the disk cache of this machine; those that were compiled here for that."""
    made: list[str] = []
    wanted = [group for group in groups if group not in _ready]
    for wait in (False, True):  # first what nobody else is at
        for group in list(wanted):
            file = mark(group)
            # the folder in the name: other caches do not wait for this one
            place = hashlib.sha256(str(file.parent).encode()).hexdigest()[:10]
            with nullcontext(True) if file.is_file() else alone_on_machine(f"{group}-{place}", wait) as mine:
                if not mine:
                    continue
                if not file.is_file():
                    GROUPS[group]()
                    made.append(group)
                    with suppress(OSError):  # a cache that cannot be written: then every process compiles
                        file.parent.mkdir(parents=True, exist_ok=True)
                        file.touch()
                _ready.add(group)
                wanted.remove(group)
    return made
