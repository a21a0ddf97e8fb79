"""Expressions against NumPy, and what is none refused at its character."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.fem.loads.expression import DEEPEST, LONGEST, Expression, ExpressionError

X, Y = np.random.default_rng(3).uniform(0.1, 0.9, (2, 7))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("20e3 + 5e3*sin(pi*x/2)", 20e3 + 5e3 * np.sin(np.pi * X / 2)),
        ("-x^2", -(X**2)),
        ("2^-x", 2.0**-X),
        ("2^3^2 + 0*x", np.full(7, 512.0)),
        ("x - y - 1", X - Y - 1),
        ("x/y/2", X / Y / 2),
        ("x**2*y", X**2 * Y),
        ("--x + +y", X + Y),
        ("(x + y)*(x - y)", X**2 - Y**2),
        ("min(x, y, 0.5) + max(x, 0.5)", np.minimum(np.minimum(X, Y), 0.5) + np.maximum(X, 0.5)),
        ("step(x - 0.5)", (X >= 0.5).astype(float)),
        ("abs(x-y) + hypot(x, y) + atan2(y, x)", np.abs(X - Y) + np.hypot(X, Y) + np.arctan2(Y, X)),
        ("exp(-x)*log(y) + sqrt(x) + tanh(y)", np.exp(-X) * np.log(Y) + np.sqrt(X) + np.tanh(Y)),
        (" .5 + 3. ", np.full(7, 3.5)),
        ("pi", np.full(7, np.pi)),
    ],
)
def test_values_are_those_of_numpy(text, value):
    found = Expression(text)(X, Y)
    assert found.shape == X.shape
    np.testing.assert_allclose(found, value, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "character 1: an empty expression"),
        ("   ", "character 1: an empty expression"),
        ("x +", "character 4: the end is out of place"),
        ("x y", "character 3: 'y' is out of place; an operator or the end"),
        ("2x", "character 2: 'x' is out of place"),
        ("sn(x)", "character 1: 'sn' is not one of x, y, pi, sin"),
        ("sinus(x)", "the nearest is 'sin'"),
        ("sin x", "character 5: the function 'sin' needs '('"),
        ("sin(x, y)", "character 1: 'sin' has 2 arguments, it needs 1"),
        ("min(x)", "'min' has 1 argument, it needs at least 2"),
        ("(x + 1", "character 7: the end where the ')' of character 1 is missing"),
        ("x(2)", "character 2: 'x' is not a function"),
        ("x ; y", "character 3: ';' has no meaning"),
        ("２ * x", "character 1: '２' has no meaning"),  # digits of other scripts are taken for a slip of the keyboard
        ("1e٣", "character 3: '٣' has no meaning"),
        ("__import__(x)", "'__import__' is not one of"),
        ("x.real", "character 2: '.' has no meaning"),
        ("1e999", "the number 1e999 is too large"),
        ("1 +" * 400 + "1", f"{LONGEST} are allowed"),
        ("(" * 60 + "x" + ")" * 60, f"more than {DEEPEST} levels"),
        ("-" * 60 + "x", f"more than {DEEPEST} levels"),
        ("x^" * 60 + "x", f"more than {DEEPEST} levels"),
        ("sin(" * 60 + "x" + ")" * 60, f"more than {DEEPEST} levels"),
    ],
)
def test_other_texts_are_refused_at_their_character(text, sentence):
    with pytest.raises(ExpressionError) as error:
        Expression(text)
    assert sentence in str(error.value) and "\n" not in str(error.value)


def test_any_text_is_an_expression_or_refused():
    random = np.random.default_rng(11)
    pieces = [
        "x",
        "y",
        "pi",
        "1",
        "2.5e3",
        "+",
        "-",
        "*",
        "/",
        "^",
        "**",
        "(",
        ")",
        ",",
        "sin",
        "min",
        "step",
        " ",
        "e",
        "\u00e9",
    ]
    legal = 0
    for _ in range(3000):
        text = "".join(random.choice(pieces, random.integers(1, 9)))
        try:
            assert Expression(text)(X, Y).shape == X.shape
            legal += 1
        except ExpressionError:
            continue
    assert legal > 30
