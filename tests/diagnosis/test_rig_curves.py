"""What is on no list: the variable that the rest depends on, on machines simulated elsewhere."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from tests.diagnosis.test_rig_evidence import logs_of, prepared
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.html import evidence
from dmptm_ctrl.diagnosis.rig_curves import _clock, accepted, curves, torques_of, variables_of
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig
from dmptm_ctrl.diagnosis.rig_figures import folded
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.plots.diagnosis import plot_evidence

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


def picture(base):
    """Half the sum and half the difference of the curves by direction, over the variable."""
    best = curves(base)[0]
    made = folded(base, base, best.variable, "", "N·m", best)
    plus, minus = (made.before[way] for way in ("forward", "backward"))
    both, a, b = np.intersect1d(plus.x, minus.x, return_indices=True)
    there, back = plus.mean[a], minus.mean[b]
    return made, both, 0.5 * (there + back), 0.5 * (there - back)


def test_picture_of_a_play_is_by_the_way_of_the_input():
    """While it rises, the drive gets PLAY less than the log says; while it falls, more."""
    base = base_of(play)
    made, u, _, odd = picture(base)
    assert made.ways == ("rising", "falling")
    middle = odd[np.abs(u) < 3.0]
    np.testing.assert_allclose(middle, PLAY * Machine().gain, rtol=0.25)
    assert plot_evidence(made)[0].get_legend_handles_labels()[1] == ["rising", "falling"]
    plt.close("all")
    page = SimpleNamespace(effects=(), depends_on=("u",), source=SimpleNamespace())
    page.source.evidence = lambda effect, variables: made
    assert "Where rising and falling stand apart" in next(iter(evidence(page)))["read"]
    never = folded(base, base, "u", "", "N·m")  # of an effect: by the way of the motion
    assert never.ways == ("forward", "backward")


def test_picture_of_what_comes_again_is_over_one_period():
    made, time, even, _ = picture(base_of(dropouts))
    assert made.variable.startswith("time [s], over a period of 0.8")
    assert 0.9 * PERIOD < time.max() < PERIOD
    late = time > 3.0 * GONE  # and before the end, since the period is not found exactly
    late &= time < PERIOD - GONE
    assert np.abs(even[~late]).max() > 10.0 * np.abs(even[late]).max()


def test_picture_of_what_comes_again_each_turn_is_over_one_turn():
    """Friction 0.02 cos θ N·m over many turns, beside what the model takes for friction."""
    made, angle, _, odd = picture(base_of(alike, fc=0.02, pos=0.02))
    assert made.variable == "position of motor [rad], over a turn"
    assert 6.0 < angle.max() < 2.0 * np.pi
    assert 2.0 * np.mean(odd * np.cos(angle)) == pytest.approx(0.02, rel=0.2)


@pytest.mark.long
def test_picture_of_a_wave_is_over_one_of_its_periods():
    """Cogging of 7 per turn over many turns: each bin of a turn would hold a part of a wave."""
    bench = Bench(Machine(fc=0.02, cog=0.01, order=7.0), (("multisine", 5.0),), 20.0, 1e-3)
    rig = parse_rig(bench.rig(), "rig.toml")
    found = diagnose_rig(logs_of(bench, rig), rig, jobs=1)
    wave = next(e for e in found.effects if e.name == "cogging")
    made = found.source.evidence(wave, ())
    assert made.variable.endswith(", over one wave")
    for curve in made.before.values():
        assert curve.x.max() < 2.0 * np.pi / 7.0
        swing = 2.0 * np.mean(curve.mean * np.exp(7j * curve.x))
        assert abs(swing) == pytest.approx(0.01, rel=0.1)


def test_nothing_where_nothing_is_missing():
    assert all(c.evidence < LEVEL for c in accepted(curves(base_of(alike))))


def test_a_period_is_found_in_logs_that_begin_the_clock_anew():
    base = base_of(dropouts)
    time = variables_of(base.fit)["time"]
    period, _ = _clock(base, dict(torques_of(base.fit, time))["gain"])
    assert period == pytest.approx(PERIOD, rel=0.02)
