"""What is on no list: the variable that the rest depends on, on machines simulated elsewhere."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from tests.diagnosis.test_rig_evidence import prepared
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.rig_curves import _clock, accepted, curves, torques_of, variables_of

KINDS = (("multisine", 6.0), ("sine", 5.0), ("chirp", 4.0))
PLAY = 0.4  # V, to each side
PERIOD, GONE = 0.83, 0.06  # s


def play(u, dt):
    """Command behind a play: it follows only when the play is used up."""
    out, now = np.empty_like(u), 0.0
    for i, value in enumerate(u):
        out[i] = now = min(value + PLAY, max(value - PLAY, now))
    return out


def dropouts(u, dt):
    """Nothing for a moment of each period."""
    return np.where(dt * np.arange(u.size) % PERIOD < GONE, 0.0, u)


def weaker(u, dt):
    """A tenth less from a time on."""
    return np.where(dt * np.arange(u.size) > 2.1, 0.9 * u, u)


def alike(u, dt):
    return u


@dataclass(frozen=True)
class Odd(Machine):
    """A machine whose drive changes what the log says of its input."""

    def run(self, u, dt, **options):
        return super().run(self.drive(u, dt), dt, **options)


@cache
def base_of(drive, **machine):
    own = type("Own", (Odd,), {"drive": staticmethod(drive)})
    return prepared(Bench(own(**machine), KINDS, 4.0, 2e-3))[1]


@pytest.mark.parametrize(("drive", "variable"), [(play, "u"), (dropouts, "time"), (weaker, "time")])
def test_what_the_rest_depends_on(drive, variable):
    base = base_of(drive)
    found = accepted(curves(base))
    assert found[0].variable == variable
    # of held-out logs too, and more than any other variable
    assert found[0].share > 0.5
    others = [c.share for c in found if c.variable != variable]
    assert max(others, default=0.0) < 0.8 * found[0].share


def test_friction_in_a_part_of_the_turn():
    """The angle goes on over many turns; what comes again each turn is seen."""
    base = base_of(alike, fc=0.02, pos=0.02)
    found = accepted(curves(base))
    assert found[0].variable == "theta:motor"


def test_nothing_where_nothing_is_missing():
    assert all(c.evidence < LEVEL for c in accepted(curves(base_of(alike))))


def test_a_period_is_found_in_logs_that_begin_the_clock_anew():
    base = base_of(dropouts)
    time = variables_of(base.fit)["time"]
    period, _ = _clock(base, dict(torques_of(base.fit, time))["gain"])
    assert period == pytest.approx(PERIOD, rel=0.02)
