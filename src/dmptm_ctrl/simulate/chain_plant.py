"""The numbers of a chain as the compiled loop takes them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PARAMETERS = 6  # room for those of one effect


class Plant(NamedTuple):
    """A chain or branched train; the index of a coordinate is the first axis.

    A coordinate is what a rigid group of bodies shares; body b turns by ratio · coordinate.
    A link's twist is z = q_first − ratio · q_second; its torque acts −τ on the first body and
    +ratio · τ on the second.
    """

    inertia: Floats  # (n,) kg·m² or kg, of the whole group
    distance: Floats  # (n,) presliding, 0 is none
    given: Ints  # (n,) 1 where the motion is prescribed
    body_coordinate: Ints  # (bodies,)
    body_ratio: Floats  # (bodies,)
    law: Floats  # (bodies, 9) fields of Stribeck
    link_body: Ints  # (links, 2)
    link_values: Floats  # (links, 5) ratio, stiffness, damping, gap damping, half-gap
    link_gap: Ints  # (links,) 1 where the teeth can part
    input_body: Ints  # (inputs,)
    input_values: Floats  # (inputs, 4) gain, dead time, lag, limit (0 is none)
    drive_place: Ints  # (effects, 2) kind, input
    drive_values: Floats  # (effects, PARAMETERS)
    torque_place: Ints  # (effects, 2) kind, body
    torque_values: Floats
    friction_place: Ints  # (effects, 2) kind, body
    friction_values: Floats
