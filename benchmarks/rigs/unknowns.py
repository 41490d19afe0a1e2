"""Effects on nobody's list, each with the variables it truly depends on."""

import numpy as np

from rigs.catalogue import sign


def unpowered_motor(p, rng, strength):
    """One motor is unpowered for 60 ms at fixed intervals."""
    p.cut_motor, p.cut_period = int(rng.integers(2)), rng.uniform(0.4, 0.9)
    p.cut_length, p.cut_start = 0.06 * strength, rng.uniform(0.1, 0.4)
    return {"period_s": p.cut_period, "length_s": p.cut_length, "motor": int(p.cut_motor)}


UNKNOWN = {"unpowered_motor": (unpowered_motor, ("time", "u"))}
