"""Reversals one by one: runs led by the measured angle until just before the meshes open.

From rest a run tells of the first reversals only: after a dozen bounces chance has a say. While
both meshes are closed the drive forgets; led by the measured angle there and let go just before
the meshes open, a run meets each reversal of a log afresh, at another angle of the ring gear.
Source: multiple shooting, Bock, Springer Ser. Chem. Phys. 18 (1981) 102; the leading is
synchronisation, Voss, Timmer & Kurths, Int. J. Bifurcation Chaos 14 (2004) 1905.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.identify.led import LEAD_HZ
from dmptm_ctrl.identify.records import Record, predict
from dmptm_ctrl.simulate.model import Floats, Model

PRESSED_SECONDS = 0.1  # for which both meshes stay closed before they open
LEAD_SECONDS = 0.3  # of the lead, eleven of its time constants; rattle before it is forgotten, too
FREE_SECONDS = 0.02  # between the end of the lead and the opening


def reversals(records: Iterable[Record], model: Model, seconds: float) -> tuple[Record, ...]:
    """Cut logs where both meshes, closed for a while, open.

    Parameters
    ----------
    records : iterable of Record
    model : Model
        Tells where the meshes are closed, led by the measured angle.
    seconds : float
        Kept after the opening.
    """
    arrays = model.arrays()
    gaps = [model.drive["gap_l"], model.drive["gap_r"]]
    found = []
    for rec in records:
        out = predict(rec, arrays, LEAD_HZ)
        for opened in openings(out[:, 6:8], gaps, round(PRESSED_SECONDS / rec.dt)):
            found.append(segment(rec, out, model, opened, seconds))
    return tuple(found)


def openings(z: Floats, gaps: list[float], least: int) -> NDArray[np.intp]:
    """Samples at which a mesh opens after both were closed, on the same sides, for `least`."""
    side = np.sign(z) * (np.abs(z) > gaps)
    pressed = (side != 0.0).all(1)
    pressed[1:] &= (side[1:] == side[:-1]).all(1)
    edges = np.flatnonzero(np.diff(pressed.astype(int)))
    ends = edges[pressed[edges]] + 1
    since = np.flatnonzero(~pressed)
    long = [end - 1 - since[since < end].max(initial=-1) >= least for end in ends]
    return np.asarray(ends[np.array(long, bool)])


def segment(rec: Record, out: Floats, model: Model, opened: int, seconds: float) -> Record:
    """Return what goes around an opening, led up to just before it."""
    free = max(0, opened - round(FREE_SECONDS / rec.dt))
    first = max(0, free - round(LEAD_SECONDS / rec.dt))
    last = min(rec.omega.size, opened + round(seconds / rec.dt))
    n2 = model.drive["N_2"]
    theta, omega, z = out[first, 0], out[first, 1], out[first, 6:8]
    part = slice(first, last)
    return replace(
        rec,
        name=f"{rec.name} at {rec.time[opened]:.3f} s",
        u=np.ascontiguousarray(rec.u[:, part]),
        theta=rec.theta[part],
        omega=rec.omega[part],
        twist=None if rec.twist is None else rec.twist[part],
        x0=np.array([*(z + n2 * theta), theta, n2 * omega, n2 * omega, omega]),
        time=rec.time[part] - rec.time[0],  # as that of a run from the start of the log
        led=free - first,
    )
