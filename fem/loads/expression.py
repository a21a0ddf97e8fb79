"""Expressions in x and y from text: a small closed grammar, parsed here, never evaluated as Python.

    sum      = product { ("+" | "-") product }
    product  = signed { ("*" | "/") signed }
    signed   = { "+" | "-" } power
    power    = atom [ ("^" | "**") signed ]            a power binds tighter than a sign, from the right
    atom     = number | "x" | "y" | "pi" | function "(" sum { "," sum } ")" | "(" sum ")"

An expression is a program for a stack of arrays, so that it is evaluated at all places at once.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST = 1000
"""Characters of an expression."""
DEEPEST = 50
"""Parentheses, signs and powers within each other."""

_MANY = 99
FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int]] = {
    "sin": (np.sin, 1, 1),
    "cos": (np.cos, 1, 1),
    "tan": (np.tan, 1, 1),
    "asin": (np.arcsin, 1, 1),
    "acos": (np.arccos, 1, 1),
    "atan": (np.arctan, 1, 1),
    "atan2": (np.arctan2, 2, 2),
    "sinh": (np.sinh, 1, 1),
    "cosh": (np.cosh, 1, 1),
    "tanh": (np.tanh, 1, 1),
    "exp": (np.exp, 1, 1),
    "log": (np.log, 1, 1),
    "sqrt": (np.sqrt, 1, 1),
    "abs": (np.abs, 1, 1),
    "hypot": (np.hypot, 2, 2),
    "min": (np.minimum, 2, _MANY),
    "max": (np.maximum, 2, _MANY),
    "step": (lambda value: np.where(value >= 0.0, 1.0, np.where(value < 0.0, 0.0, np.nan)), 1, 1),
}
"""Function, fewest and most arguments; ``step`` is 1 from zero on and 0 below, ``log`` is the natural logarithm."""
VARIABLES = ("x", "y")
CONSTANTS = {"pi": float(np.pi)}

_TOKEN = re.compile(
    r"\s*(?:((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)|([A-Za-z_][A-Za-z_0-9]*)|(\*\*|[-+*/^(),]))"
)
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.power,
}


class ExpressionError(ValueError):
    """A text is no expression; the message says at which character and what is legal there."""


class Expression:
    """A function of place, from text.

    Parameters
    ----------
    text : str
        Numbers, ``x``, ``y`` [m], ``pi``, ``+ - * / ^`` (or ``**``), parentheses, and the functions of `FUNCTIONS`.

    Raises
    ------
    ExpressionError
        If it is not of the grammar, longer than `LONGEST` or deeper than `DEEPEST`.

    Examples
    --------
    >>> Expression("20e3 + 5e3*sin(pi*x/2)")(np.array([0.0, 1.0]), np.zeros(2)).tolist()
    [20000.0, 25000.0]
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._program = _Parser(text).program

    def __call__(self, x: Array, y: Array, *_: Array) -> Array:
        """Values at places, of their shape; not finite where a function is outside its domain."""
        stack: list[Any] = []
        with np.errstate(all="ignore"):
            for kind, what, count in self._program:
                if kind == "number":
                    stack.append(what)
                elif kind == "variable":
                    stack.append(x if what == "x" else y)
                else:
                    arguments = stack[-count:]
                    del stack[-count:]
                    value = what(arguments[0]) if count == 1 else what(arguments[0], arguments[1])
                    for further in arguments[2:]:
                        value = what(value, further)
                    stack.append(value)
        return np.array(np.broadcast_to(np.asarray(stack[0], dtype=np.float64), np.shape(x)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Expression) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __repr__(self) -> str:
        return repr(self.text)


class _Parser:
    """Recursive descent; writes the program of a stack machine: (kind, what, number of arguments)."""

    def __init__(self, text: str) -> None:
        self._text = text
        if len(text) > LONGEST:
            raise ExpressionError(f"an expression of {len(text)} characters is too long; {LONGEST} are allowed")
        self.program: list[tuple[str, Any, int]] = []
        self._tokens = self._split()
        self._next = 0
        self._depth = 0
        if len(self._tokens) == 1:
            raise self._error(0, "an empty expression")
        self._sum()
        if self._kind != "end":
            raise self._error(self._place, f"{self._shown} is out of place; an operator or the end is legal here")

    def _split(self) -> list[tuple[str, str, int]]:
        """Tokens: "number", "name", "sign" or "end", with text and place."""
        found, place, end = [], 0, len(self._text.rstrip())
        while place < end:
            match = _TOKEN.match(self._text, place)
            if match is None:
                place += len(self._text[place:]) - len(self._text[place:].lstrip())
                raise self._error(place, f"{self._text[place]!r} has no meaning in an expression")
            kind = ("number", "name", "sign")[(match.lastindex or 1) - 1]
            found.append((kind, match[match.lastindex or 1], match.start(match.lastindex or 1)))
            place = match.end()
        return [*found, ("end", "", end)]

    @property
    def _kind(self) -> str:
        return self._tokens[self._next][0]

    @property
    def _token(self) -> str:
        return self._tokens[self._next][1]

    @property
    def _place(self) -> int:
        return self._tokens[self._next][2]

    @property
    def _shown(self) -> str:
        return "the end" if self._kind == "end" else repr(self._token)

    def _error(self, place: int, text: str) -> ExpressionError:
        around = self._text[max(0, place - 20) : place + 20]
        near = f" (near {around.strip()!r})" if around.strip() else ""
        return ExpressionError(f"character {place + 1}: {text}{near}")

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._error(self._place, f"more than {DEEPEST} levels within each other")

    def _emit(self, operator: str) -> None:
        self.program.append(("call", _OPERATORS[operator], 2))

    def _sum(self) -> None:
        self._product()
        while self._token in ("+", "-"):
            sign = self._token
            self._next += 1
            self._product()
            self._emit(sign)

    def _product(self) -> None:
        self._signed()
        while self._token in ("*", "/"):
            sign = self._token
            self._next += 1
            self._signed()
            self._emit(sign)

    def _signed(self) -> None:
        if self._token not in ("+", "-"):
            self._power()
            return
        self._deeper()
        sign = self._token
        self._next += 1
        self._signed()
        if sign == "-":
            self.program.append(("call", np.negative, 1))
        self._depth -= 1

    def _power(self) -> None:
        self._atom()
        if self._token in ("^", "**"):
            self._deeper()
            self._next += 1
            self._signed()
            self._emit("^")
            self._depth -= 1

    def _atom(self) -> None:
        kind, token, place = self._tokens[self._next]
        if kind == "number":
            value = float(token)
            if not np.isfinite(value):
                raise self._error(place, f"the number {token} is too large")
            self.program.append(("number", value, 0))
            self._next += 1
        elif kind == "name":
            self._next += 1
            self._name(token, place)
        elif token == "(":
            self._deeper()
            self._next += 1
            self._sum()
            self._close(place)
            self._depth -= 1
        else:
            raise self._error(
                place, f"{self._shown} is out of place; a number, x, y, pi, a function or '(' is legal here"
            )

    def _close(self, opened: int) -> None:
        if self._token != ")":
            raise self._error(self._place, f"{self._shown} where the ')' of character {opened + 1} is missing")
        self._next += 1

    def _name(self, name: str, place: int) -> None:
        if name in VARIABLES:
            self.program.append(("variable", name, 0))
        elif name in CONSTANTS:
            self.program.append(("number", CONSTANTS[name], 0))
        elif name in FUNCTIONS:
            self._call(name, place)
            return
        else:
            legal = [*VARIABLES, *CONSTANTS, *FUNCTIONS]
            near = get_close_matches(name, legal, 1, 0.4)
            nearest = f"; the nearest is {near[0]!r}" if near else ""
            raise self._error(place, f"{name[:40]!r} is not one of {', '.join(legal)}{nearest}")
        if self._token == "(":
            raise self._error(self._place, f"{name!r} is not a function; write {name}*( for a product")

    def _call(self, name: str, place: int) -> None:
        function, fewest, most = FUNCTIONS[name]
        if self._token != "(":
            raise self._error(self._place, f"the function {name!r} needs '(' and its argument")
        self._deeper()
        opened = self._place
        self._next += 1
        count = 1
        self._sum()
        while self._token == ",":
            self._next += 1
            self._sum()
            count += 1
        self._close(opened)
        self._depth -= 1
        if not fewest <= count <= most:
            wanted = f"{fewest}" if fewest == most else f"at least {fewest}" if count < fewest else f"at most {most}"
            raise self._error(place, f"{name!r} has {count} argument{'s' * (count > 1)}, it needs {wanted}")
        self.program.append(("call", function, count))
