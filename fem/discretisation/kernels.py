"""Compiled loops over elements, points and matrix entries.

Each loop writes its own piece of the output and sums in a fixed order, so that results do not depend on the number of
threads: element contributions go to a buffer of their own and are gathered afterwards by rows. Loops over elements take
the range from `first` up to, not including, `end`, and threads share them (`constitutive.threads`); gathering is cheap
and serial. What they are handed was checked in `assembly`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.compilation import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int32]


@compiled(("fem",), nogil=True)
def strain_kernel(
    first: int,
    end: int,
    gradients: Array,
    element_nodes: Indices,
    points_per_cell: int,
    displacement: Array,
    out: Array,
) -> None:
    """Strain ``B u`` at all points (xx, yy, engineering xy)."""
    nb = element_nodes.shape[1]
    for element in range(first, end):
        for q in range(points_per_cell):
            point = element * points_per_cell + q
            xx = 0.0
            yy = 0.0
            xy = 0.0
            for b in range(nb):
                node = element_nodes[element, b]
                ux = displacement[2 * node]
                uy = displacement[2 * node + 1]
                gx = gradients[point, b, 0]
                gy = gradients[point, b, 1]
                xx += gx * ux
                yy += gy * uy
                xy += gy * ux + gx * uy
            out[point, 0] = xx
            out[point, 1] = yy
            out[point, 2] = xy


@compiled(("fem",), nogil=True)
def element_force_kernel(
    first: int, end: int, gradients: Array, weights: Array, points_per_cell: int, stress: Array, out: Array
) -> None:
    """Element vectors ``sum_q w B^T sigma``, shape (nelem, nb, 2)."""
    nb = out.shape[1]
    for element in range(first, end):
        for b in range(nb):
            out[element, b, 0] = 0.0
            out[element, b, 1] = 0.0
        for q in range(points_per_cell):
            point = element * points_per_cell + q
            xx = weights[point] * stress[point, 0]
            yy = weights[point] * stress[point, 1]
            xy = weights[point] * stress[point, 2]
            for b in range(nb):
                gx = gradients[point, b, 0]
                gy = gradients[point, b, 1]
                out[element, b, 0] += gx * xx + gy * xy
                out[element, b, 1] += gy * yy + gx * xy


@compiled(("fem",))
def gather_force_kernel(start: Indices, source: Indices, local: Array, out: Array, magnitude: Array) -> None:
    """Nodal sums of the element vectors, and sums of their magnitudes (the scale of rounding)."""
    for node in range(len(start) - 1):
        x = 0.0
        y = 0.0
        ax = 0.0
        ay = 0.0
        for k in range(start[node], start[node + 1]):
            fx = local[source[k], 0]
            fy = local[source[k], 1]
            x += fx
            y += fy
            ax += abs(fx)
            ay += abs(fy)
        out[2 * node] = x
        out[2 * node + 1] = y
        magnitude[2 * node] = ax
        magnitude[2 * node + 1] = ay


@compiled(("fem",), nogil=True)
def element_tangent_kernel(
    first: int, end: int, gradients: Array, weights: Array, points_per_cell: int, tangent: Array, out: Array
) -> None:
    """Element matrices ``sum_q w B^T D B``, shape (nelem, 2 nb, 2 nb); D need not be symmetric."""
    nb = gradients.shape[1]
    for element in range(first, end):
        for i in range(2 * nb):
            for j in range(2 * nb):
                out[element, i, j] = 0.0
        for q in range(points_per_cell):
            point = element * points_per_cell + q
            w = weights[point]
            d00 = w * tangent[point, 0, 0]
            d01 = w * tangent[point, 0, 1]
            d02 = w * tangent[point, 0, 2]
            d10 = w * tangent[point, 1, 0]
            d11 = w * tangent[point, 1, 1]
            d12 = w * tangent[point, 1, 2]
            d20 = w * tangent[point, 2, 0]
            d21 = w * tangent[point, 2, 1]
            d22 = w * tangent[point, 2, 2]
            for i in range(nb):
                hx = gradients[point, i, 0]
                hy = gradients[point, i, 1]
                # The two rows of B_i^T D.
                x0 = hx * d00 + hy * d20
                x1 = hx * d01 + hy * d21
                x2 = hx * d02 + hy * d22
                y0 = hy * d10 + hx * d20
                y1 = hy * d11 + hx * d21
                y2 = hy * d12 + hx * d22
                for j in range(nb):
                    gx = gradients[point, j, 0]
                    gy = gradients[point, j, 1]
                    out[element, 2 * i, 2 * j] += x0 * gx + x2 * gy
                    out[element, 2 * i, 2 * j + 1] += x1 * gy + x2 * gx
                    out[element, 2 * i + 1, 2 * j] += y0 * gx + y2 * gy
                    out[element, 2 * i + 1, 2 * j + 1] += y1 * gy + y2 * gx


@compiled(("fem",))
def gather_tangent_kernel(start: Indices, source: Indices, local: Array, out: Array) -> None:
    """Matrix entries as sums of element matrix entries in a fixed order."""
    for entry in range(len(out)):
        total = 0.0
        for k in range(start[entry], start[entry + 1]):
            total += local[source[k]]
        out[entry] = total


@compiled(("fem",), nogil=True)
def element_action_kernel(
    first: int,
    end: int,
    gradients: Array,
    weights: Array,
    element_nodes: Indices,
    points_per_cell: int,
    tangent: Array,
    displacement: Array,
    out: Array,
) -> None:
    """Element vectors ``sum_q w B^T D B u``, shape (nelem, nb, 2): the tangent's action without the matrix."""
    nb = element_nodes.shape[1]
    for element in range(first, end):
        for b in range(nb):
            out[element, b, 0] = 0.0
            out[element, b, 1] = 0.0
        for q in range(points_per_cell):
            point = element * points_per_cell + q
            exx = 0.0
            eyy = 0.0
            exy = 0.0
            for b in range(nb):
                node = element_nodes[element, b]
                ux = displacement[2 * node]
                uy = displacement[2 * node + 1]
                gx = gradients[point, b, 0]
                gy = gradients[point, b, 1]
                exx += gx * ux
                eyy += gy * uy
                exy += gy * ux + gx * uy
            w = weights[point]
            xx = w * (tangent[point, 0, 0] * exx + tangent[point, 0, 1] * eyy + tangent[point, 0, 2] * exy)
            yy = w * (tangent[point, 1, 0] * exx + tangent[point, 1, 1] * eyy + tangent[point, 1, 2] * exy)
            xy = w * (tangent[point, 2, 0] * exx + tangent[point, 2, 1] * eyy + tangent[point, 2, 2] * exy)
            for b in range(nb):
                gx = gradients[point, b, 0]
                gy = gradients[point, b, 1]
                out[element, b, 0] += gx * xx + gy * xy
                out[element, b, 1] += gy * yy + gx * xy
