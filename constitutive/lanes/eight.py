"""Eight points side by side: a number type of the compiler, so that physics is written once, for one point.

A compiled function whose arguments are of this type does with eight numbers at once what it does with one number: every
operation is one vector instruction (or two, where the processor has but 256 bits). The formulas stay plain; only where
numbers decide, the decision has to be a `choose` between two results instead of a branch, because of eight numbers some
decide one way and some the other. Called with ordinary numbers, by the interpreter or compiled, the same functions work
on one point.

Lane i of a result depends on lane i of the arguments alone, by IEEE arithmetic: a point's result is the same to the
last bit in whichever lane it lies and whatever the others hold.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model

WIDTH = 8
LANES = tuple(range(WIDTH))
"""Passed to a kernel, makes it work on eight points at a time."""
ONE_LANE = (0,)
"""Makes it work on one."""
LANES_OF_KERNELS = ONE_LANE if config.DISABLE_JIT else LANES  # type: ignore[attr-defined]
"""Of kernels that can do with either; the interpreter knows single numbers only."""

_DOUBLE, _LONG = ir.DoubleType(), ir.IntType(64)
_EIGHT_DOUBLES, _EIGHT_LONGS = ir.VectorType(_DOUBLE, WIDTH), ir.VectorType(_LONG, WIDTH)
_EIGHT_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class Eight(types.Type):
    """Eight numbers."""

    def __init__(self) -> None:
        super().__init__(name="Eight")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        return Conversion.promote if isinstance(other, (types.Float, types.Integer)) else None

    def unify(self, typingctx: Any, other: types.Type) -> Any:
        return self if isinstance(other, (types.Float, types.Integer)) else None


class EightDecisions(types.Type):
    """Eight truth values."""

    def __init__(self) -> None:
        super().__init__(name="EightDecisions")


EIGHT, DECISIONS = Eight(), EightDecisions()


@register_model(Eight)
class _EightModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _EIGHT_DOUBLES)


@register_model(EightDecisions)
class _DecisionsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _EIGHT_BITS)


def _repeated(builder: Any, value: Any) -> Any:
    """The number in all eight lanes."""
    if isinstance(value, ir.Constant) and isinstance(value.constant, float):
        return ir.Constant(_EIGHT_DOUBLES, [value.constant] * WIDTH)
    first = builder.insert_element(ir.Constant(_EIGHT_DOUBLES, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(_EIGHT_DOUBLES, ir.Undefined), zeros)


@lower_cast(types.Float, EIGHT)
@lower_cast(types.Integer, EIGHT)
def _cast(context: Any, builder: Any, source: types.Type, target: types.Type, value: Any) -> Any:
    return _repeated(builder, context.cast(builder, value, source, types.float64))


def _declare(function: Any, number: int, of: type, result: types.Type, emit: Callable[[Any, Any], Any]) -> None:
    """Let an operator or a function of Python work on eight numbers (or decisions)."""
    operand = EIGHT if of is Eight else DECISIONS
    others = (types.Float, types.Integer) if of is Eight else ()

    class Template(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            legal = len(args) == number and all(isinstance(arg, (of, *others)) for arg in args)
            if legal and any(isinstance(arg, of) for arg in args):
                return signature(result, *([operand] * number))
            return None

    infer_global(function)(Template)

    @lower_builtin(function, *([operand] * number))
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, args)


def _instruction(name: str) -> Callable[[Any, Any], Any]:
    return lambda builder, args: getattr(builder, name)(*args)


def _comparison(name: str) -> Callable[[Any, Any], Any]:
    return lambda builder, args: builder.fcmp_ordered(name, *args)


for _plain, _inplace, _name in (
    (operator.add, operator.iadd, "fadd"),
    (operator.sub, operator.isub, "fsub"),
    (operator.mul, operator.imul, "fmul"),
    (operator.truediv, operator.itruediv, "fdiv"),
):
    for _operator in (_plain, _inplace):
        _declare(_operator, 2, Eight, EIGHT, _instruction(_name))
for _operator, _name in (
    *((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "==")),
):
    _declare(_operator, 2, Eight, DECISIONS, _comparison(_name))
_declare(operator.ne, 2, Eight, DECISIONS, lambda builder, args: builder.fcmp_unordered("!=", *args))
_declare(operator.neg, 1, Eight, EIGHT, lambda builder, args: builder.fneg(args[0]))
for _operator in (operator.and_, operator.iand):
    _declare(_operator, 2, EightDecisions, DECISIONS, lambda builder, args: builder.and_(*args))
for _operator in (operator.xor, operator.ixor):
    _declare(_operator, 2, EightDecisions, DECISIONS, lambda builder, args: builder.xor(*args))
for _operator in (operator.or_, operator.ior):
    _declare(_operator, 2, EightDecisions, DECISIONS, lambda builder, args: builder.or_(*args))


def _of_machine(name: str) -> Callable[[Any, Any], Any]:
    def emit(builder: Any, args: Any) -> Any:
        kind = ir.FunctionType(_EIGHT_DOUBLES, [_EIGHT_DOUBLES])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v8f64")
        return builder.call(function, args)

    return emit


_declare(abs, 1, Eight, EIGHT, _of_machine("fabs"))
_declare(math.sqrt, 1, Eight, EIGHT, _of_machine("sqrt"))


def choose(decision: Any, first: Any, second: Any) -> Any:
    """`first` where the decision is true, else `second`; both are computed. Tuples are chosen entry by entry."""
    return first if decision else second


def somewhere(decision: Any) -> Any:
    """Whether it is true in any lane."""
    return bool(decision)


def two_to_the(n: Any) -> Any:
    """2^n for a number that is an integer between -1022 and 1023."""
    return 2.0**n


def exponent(x: Any) -> Any:
    """The largest integer n with 2^n <= x, as a number, for a positive normal x."""
    return float(math.frexp(x)[1] - 1)


def read(array: Any, row: Any, lanes: Any) -> Any:
    """The numbers of a row of a contiguous array of shape (rows, lanes)."""
    return float(array[row, 0])


def write(array: Any, row: Any, value: Any, lanes: Any) -> None:
    """Put numbers into a row of a contiguous array of shape (rows, lanes)."""
    array[row, 0] = value


def _typed(function: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of what gives result and argument types of a function of this file (or None)."""

    def decorate(generic: Callable[..., Any]) -> Any:
        template = type("Template", (AbstractTemplate,), {"key": function, "generic": lambda self, a, k: generic(*a)})
        infer_global(function)(template)
        return generic

    return decorate


def _chosen_type(decision: Any, first: Any, second: Any) -> Any:
    """Type of what is chosen: numbers become eight numbers where eight decide, or the other one is eight."""
    if isinstance(first, types.BaseTuple):
        ones, others = list(first), list(second)  # type: ignore[call-overload]
        parts = [_chosen_type(decision, ones[i], others[i]) for i in range(len(ones))]
        if isinstance(first, types.BaseNamedTuple):
            kind: Any = first.instance_class  # type: ignore[attr-defined]
            if all(part == parts[0] for part in parts):
                return types.NamedUniTuple(parts[0], len(parts), kind)
            return types.NamedTuple(parts, kind)
        return types.Tuple(parts)
    numbers = (types.Float, types.Integer)
    if first == second and not (isinstance(first, numbers) and isinstance(decision, EightDecisions)):
        return first
    if isinstance(first, Eight) or isinstance(second, Eight) or isinstance(decision, EightDecisions):
        return EIGHT
    return types.float64


@_typed(choose)
def _(decision: Any, first: Any, second: Any) -> Any:
    kind = _chosen_type(decision, first, second)
    return signature(kind, decision, kind, kind)


@lower_builtin(choose, types.Any, types.Any, types.Any)
def _lower_choose(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    def chosen(kind: Any, first: Any, second: Any) -> Any:
        if isinstance(kind, types.BaseTuple):
            pairs = [[builder.extract_value(value, i) for value in (first, second)] for i in range(len(kind))]
            parts = list(kind)  # type: ignore[call-overload]
            return context.make_tuple(builder, kind, [chosen(parts[i], *pairs[i]) for i in range(len(parts))])
        return first if isinstance(kind, types.NoneType) else builder.select(args[0], first, second)

    return chosen(sig.return_type, args[1], args[2])


@_typed(somewhere)
def _(decision: Any) -> Any:
    return signature(types.boolean, decision)


@lower_builtin(somewhere, DECISIONS)
def _lower_somewhere(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    bits = builder.bitcast(args[0], ir.IntType(WIDTH))
    return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))


@lower_builtin(somewhere, types.Boolean)
def _lower_here(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return args[0]


_NO_FRACTIONS = 6755399441055744.0
"""1.5 times 2^52: adding and subtracting it rounds to the nearest integer."""


@_typed(two_to_the)
def _(n: Any) -> Any:
    kind = n if isinstance(n, Eight) else types.float64
    return signature(kind, kind)


@lower_builtin(two_to_the, types.Any)
def _lower_two_to_the(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    eight = isinstance(sig.return_type, Eight)
    number, word = (_EIGHT_DOUBLES, _EIGHT_LONGS) if eight else (_DOUBLE, _LONG)

    def constant(kind: Any, value: Any) -> Any:
        return ir.Constant(kind, [value] * WIDTH if eight else value)

    # the integer n + 1023, in the last bits of a number that has no room for fractions, is the exponent of 2^n
    shifted = builder.fadd(args[0], constant(number, _NO_FRACTIONS + 1023.0))
    return builder.bitcast(builder.shl(builder.bitcast(shifted, word), constant(word, 52)), number)


@_typed(exponent)
def _(x: Any) -> Any:
    kind = x if isinstance(x, Eight) else types.float64
    return signature(kind, kind)


@lower_builtin(exponent, types.Any)
def _lower_exponent(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    eight = isinstance(sig.return_type, Eight)
    number, word = (_EIGHT_DOUBLES, _EIGHT_LONGS) if eight else (_DOUBLE, _LONG)

    def constant(kind: Any, value: Any) -> Any:
        return ir.Constant(kind, [value] * WIDTH if eight else value)

    # n + 1023 is made the last bits of the number 2^52, which has no room for fractions
    biased = builder.lshr(builder.bitcast(args[0], word), constant(word, 52))
    shifted = builder.bitcast(builder.or_(biased, constant(word, 0x4330000000000000)), number)
    return builder.fsub(shifted, constant(number, 2.0**52 + 1023.0))


def _of_lanes(lanes: Any) -> Any:
    return EIGHT if len(lanes) == WIDTH else types.float64


def _place(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Pointer to the first lane of row args[1] of array args[0]; the last argument is the tuple of lanes."""
    data = context.make_array(sig.args[0])(context, builder, args[0]).data
    width = len(sig.args[-1])
    pointer = builder.gep(data, [builder.mul(args[1], ir.Constant(args[1].type, width))])
    return builder.bitcast(pointer, _EIGHT_DOUBLES.as_pointer()) if width == WIDTH else pointer


@_typed(read)
def _(array: Any, row: Any, lanes: Any) -> Any:
    return signature(_of_lanes(lanes), array, types.intp, lanes)


@lower_builtin(read, types.Array, types.Integer, types.BaseTuple)
def _lower_read(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.load(_place(context, builder, sig, args), align=8)


@_typed(write)
def _(array: Any, row: Any, value: Any, lanes: Any) -> Any:
    return signature(types.none, array, types.intp, _of_lanes(lanes), lanes)


@lower_builtin(write, types.Array, types.Integer, types.Any, types.BaseTuple)
def _lower_write(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    builder.store(args[2], _place(context, builder, sig, args), align=8)
    return context.get_dummy_value()
