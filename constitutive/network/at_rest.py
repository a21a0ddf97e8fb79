"""No closure: a network in which nothing is lost or gained. Its answers are those of closures that give none."""

from typing import NamedTuple

from granfabric.constitutive.compilation import formula

from .point import Network


@formula
def unknowns(closure, point, stress, micro):
    """z and a_c, which stay."""
    return micro.z, micro.a1, micro.a2


@formula
def network_at(closure, point, stress, y, guess, known, here, rule, inputs, lanes):
    """The network is the unknown."""
    zero = 0.0 * y[0]
    return zero == 0.0, Network(y[0], y[1], y[2], zero, zero, zero, zero, zero, zero, zero), zero


@formula
def network_change(closure, partials, stress, change, stress_change):
    """Its change is that of the unknown."""
    return change


@formula
def rates(closure, point, stress, rate, network, guess, strain, with_derivatives, rule):
    """None."""
    zero = 0.0 * rate[0]
    none = (zero, zero, zero)
    return zero == 0.0, zero != 0.0, none, none, none, guess, zero


@formula
def rate_changes(closure, point, stress, rate, network, strain, partials, change, stress_change, rate_change, own):
    """None."""
    zero = 0.0 * rate[0]
    return zero, zero, zero


@formula
def measures(closure, p, z):
    """z by itself, a_c absolutely."""
    return z, 1.0 + 0.0 * z, True


@formula
def remember(closure, y, accepted, largest, derivatives, rotation, lanes):
    """Nothing."""
    return largest


@formula
def leave(closure, inputs, ends, point, p, network, y, largest, rule, lanes):
    """Nothing."""


@formula
def split(closure, inputs, ends, options, rule, lanes):
    """The rates tell."""
    return False


class AtRest(NamedTuple):
    """The type by which it is known; a named tuple needs an entry."""

    unused: float
