"""What an integration asks of a closure, and which closures there are.

A closure is a file that answers the questions below by functions of these names, and a named tuple of its numbers by
whose type the compiler knows whom to ask; what it does not answer is answered by `at_rest`. A new one is such a file
and a line in `CLOSURES`; nothing of a closure that a law does not use is compiled. docs/reference/kernels.md has an
example.
"""

from collections.abc import Callable
from types import ModuleType
from typing import Any

from numba.core.extending import overload

from granfabric.constitutive.compilation import FORMULA_OPTIONS

from . import at_rest, weak_force_state
from . import rates as rates_of_network
from .at_rest import AtRest
from .rates import MeanField
from .weak_force_state import ShiftedDistribution

CLOSURES: dict[type, ModuleType] = {
    AtRest: at_rest,
    MeanField: rates_of_network,
    ShiftedDistribution: weak_force_state,
}
"""Who answers for a closure of that type."""


def _asked(question: Callable[..., Any]) -> Callable[..., Any]:
    """Let compiled code ask the closure given as the first argument."""

    def of(closure: Any, *arguments: Any) -> Any:
        kind = getattr(closure, "instance_class", None)
        return None if kind is None else _answer(kind, question.__name__)

    overload(question, jit_options=FORMULA_OPTIONS, strict=False)(of)  # type: ignore[arg-type]
    return question


def _answer(kind: type, name: str) -> Any:
    return getattr(CLOSURES[kind], name, None) or getattr(at_rest, name)


@_asked
def unknowns(closure: Any, *arguments: Any) -> Any:
    """Start values of the three unknowns that are integrated with the stress."""
    return _answer(type(closure), "unknowns")(closure, *arguments)


@_asked
def measures(closure: Any, *arguments: Any) -> Any:
    """By what the first unknown and the other two are measured, and whether they are z and a_c themselves."""
    return _answer(type(closure), "measures")(closure, *arguments)


@_asked
def network_at(closure: Any, *arguments: Any) -> Any:
    """z and a_c of given stress and unknowns."""
    return _answer(type(closure), "network_at")(closure, *arguments)


@_asked
def network_change(closure: Any, *arguments: Any) -> Any:
    """Their changes with changes of stress and unknowns."""
    return _answer(type(closure), "network_change")(closure, *arguments)


@_asked
def rates(closure: Any, *arguments: Any) -> Any:
    """Rates of the unknowns for given rates of stress."""
    return _answer(type(closure), "rates")(closure, *arguments)


@_asked
def rate_changes(closure: Any, *arguments: Any) -> Any:
    """Their changes."""
    return _answer(type(closure), "rate_changes")(closure, *arguments)


@_asked
def remember(closure: Any, *arguments: Any) -> Any:
    """What an accepted substep changes beside the unknowns: the largest |s|, and unknowns that follow it."""
    return _answer(type(closure), "remember")(closure, *arguments)


@_asked
def leave(closure: Any, *arguments: Any) -> Any:
    """State columns of its own at the end of an increment."""
    return _answer(type(closure), "leave")(closure, *arguments)


@_asked
def split(closure: Any, *arguments: Any) -> Any:
    """What was gained and what was lost, where the rates do not tell: in a pass of its own over all points."""
    return _answer(type(closure), "split")(closure, *arguments)
