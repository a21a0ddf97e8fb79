"""A flexible membrane on a side of a specimen: a pressure on the outer chain of disks, which it follows.

The chain is what a ball touches that rolls up the side from the lower to the upper platen: it cannot enter gaps
narrower than itself, and comes to every disk that sticks out, so that a disk which has lost its neighbours is pressed
back instead of being left outside. Between two disks of the chain, and from the outermost ones straight to the platens,
the membrane carries the pressure times the length, normal to it, half to either disk. So the force across the specimen
is the pressure times the distance of the platens, whatever the chain looks like.

The membrane lies on the outside of its disks, a radius further out than their centres. That is the width of what
carries the axial force, and the width on which a platen presses: measured from centre to centre, a specimen of forty
disks across would stand under an axial pressure a fortieth too small, and look as much too stiff.
"""

from __future__ import annotations

from math import acos, atan2, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

BALL = 1.0
"""Radius of the rolling ball over the mean diameter."""
HOLD = 0.2
"""By how much further in, in mean diameters, a disk stays on the chain once it is on it. Else a loose disk would be
pressed in, let go, drift out and be struck anew for ever."""


class MembraneError(RuntimeError):
    """No closed chain from platen to platen."""


def outer_chain(
    position: NDArray[np.float64], radius: NDArray[np.float64], lower: float, upper: float, ball: float
) -> NDArray[np.int64]:
    """Disks on the left side from the lower to the upper platen, in the order in which a ball rolls over them.

    Parameters
    ----------
    position, radius : ndarray
        Shapes (n, 2), (n,).
    lower, upper : float
        Height of the platens.
    ball : float
        Radius of the ball.

    Raises
    ------
    MembraneError
        If the ball finds no way to the upper platen.
    """
    reach = radius + ball
    height = position[:, 1] - (lower + ball)
    near = np.flatnonzero(np.abs(height) < reach)
    if not len(near) or upper - lower <= 2.0 * ball:
        raise MembraneError("no disk lies near the lower platen: the membrane has nothing to hold on")
    touching = position[near, 0] - np.sqrt(reach[near] ** 2 - height[near] ** 2)
    at = int(near[np.argmin(touching)])
    centre = np.array([touching.min(), lower + ball])
    tree = cKDTree(position)
    widest = float(reach.max())
    chain = [at]
    came_from = -1
    for _ in range(4 * len(radius)):
        x, y = position[at]
        here = atan2(centre[1] - y, centre[0] - x)
        best, following = 2.0 * pi, -1
        rise = upper - ball - y
        if abs(rise) < reach[at]:
            for angle in (acos(rise / reach[at]) + 0.5 * pi, 0.5 * pi - acos(rise / reach[at])):
                # the ball touches the upper platen where its centre is at rise above the disk
                turned = (here - angle) % (2.0 * pi)
                if 1e-12 < turned < best:
                    best, following = turned, -2
        for other in tree.query_ball_point(position[at], reach[at] + widest):
            dx, dy = position[other, 0] - x, position[other, 1] - y
            apart = sqrt(dx * dx + dy * dy)
            if other == at or not abs(reach[at] - reach[other]) < apart < reach[at] + reach[other]:
                continue
            cosine = (reach[at] ** 2 + apart**2 - reach[other] ** 2) / (2.0 * reach[at] * apart)
            # of both places where the ball touches both disks, the one that it meets when it turns clockwise
            angle = atan2(dy, dx) + acos(min(1.0, max(-1.0, cosine)))
            turned = (here - angle) % (2.0 * pi)
            if other == came_from and (turned < 1e-9 or turned > 2.0 * pi - 1e-9):
                continue
            if turned < best:
                best, following = turned, int(other)
        if following == -2:
            return np.array(chain)
        if following < 0:
            break
        angle = here - best
        centre = np.array([x + reach[at] * np.cos(angle), y + reach[at] * np.sin(angle)])
        came_from, at = at, following
        chain.append(at)
    raise MembraneError("the membrane finds no way from the lower to the upper platen")


def membrane_forces(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    chain: NDArray[np.int64],
    lower: float,
    upper: float,
    pressure: float,
    force: NDArray[np.float64],
) -> None:
    """Add the forces of a pressure on a chain of the left side to `force`, shape (n, 2): those whose work is p dA.

    Parameters
    ----------
    chain : ndarray
        From below upwards.
    pressure : float
        Pa; forces are N per metre of thickness.
    """
    at = position[chain].copy()
    at[:, 0] -= radius[chain]
    d = np.diff(at, axis=0)
    each = 0.5 * pressure * np.column_stack([d[:, 1], -d[:, 0]])
    np.add.at(force, chain[:-1], each)
    np.add.at(force, chain[1:], each)
    # straight to the platens
    force[chain[0], 0] += pressure * (at[0, 1] - lower)
    force[chain[-1], 0] += pressure * (upper - at[-1, 1])


def both_sides(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
    lower: float,
    upper: float,
    pressure: float,
    force: NDArray[np.float64],
) -> None:
    """Add the forces of the membranes on both sides to `force`: the right one is the left one in a mirror."""
    membrane_forces(position, radius, left, lower, upper, pressure, force)
    mirrored = np.zeros_like(force)
    membrane_forces(position * [-1.0, 1.0], radius, right, lower, upper, pressure, mirrored)
    force += mirrored * [-1.0, 1.0]


def outline(
    position: NDArray[np.float64], radius: NDArray[np.float64], left: NDArray[np.int64], right: NDArray[np.int64],
    lower: float, upper: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Corners, shape (m, 2), of the area between both membranes and the platens, anticlockwise from the right below."""
    sides = []
    for chain, outwards in ((left, -1.0), (right, 1.0)):
        at = position[chain].copy()
        at[:, 0] += outwards * radius[chain]
        sides.append(np.concatenate([[[at[0, 0], lower]], at, [[at[-1, 0], upper]]]))
    return np.concatenate([sides[1], sides[0][::-1]])


def enclosed_area(
    position: NDArray[np.float64], radius: NDArray[np.float64], left: NDArray[np.int64], right: NDArray[np.int64],
    lower: float, upper: float,
) -> float:  # fmt: skip
    """Area between both membranes and the platens."""
    x, y = outline(position, radius, left, right, lower, upper).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
