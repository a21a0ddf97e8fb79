"""Operations on blocks of consecutive workspace rows whose place is known only at run time."""

from granfabric.constitutive.compilation import compiled

from .layout import KERNEL_OPTIONS

NOT_NEGATIVE = 0x7FFFFFFF
"""A mask that tells the compiler that no index is negative; without it, it has to provide for counting from the end."""


@compiled(inline="always", **KERNEL_OPTIONS)
def copy_rows(w, target, source, number):
    """w[target ...] = w[source ...]."""
    target, source = target & NOT_NEGATIVE, source & NOT_NEGATIVE
    for index in range(number):
        w[target + index] = w[source + index]


@compiled(inline="always", **KERNEL_OPTIONS)
def add_scaled(w, target, source, factor, number):
    """w[target ...] += factor w[source ...]."""
    target, source = target & NOT_NEGATIVE, source & NOT_NEGATIVE
    for index in range(number):
        w[target + index] += factor * w[source + index]
