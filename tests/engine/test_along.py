"""What effects do along a recorded motion, against their kernels sample by sample."""

import numpy as np
import pytest

from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE, LAWS
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law
from dmptm_ctrl.simulate.compose import engine
from dmptm_ctrl.simulate.model import Model

N, DT = 203, 1e-3  # three blocks and a part of one
SITES = ("drive", "motor", "mesh", "friction", "load")
# A law of the flanks changes what they carry, which no motion tells: no torque, no shift
NAMES = [name for name, effect in CATALOGUE.items() if effect.site in SITES and name not in LAWS]


def recorded(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voltages (2, n), run (n, 8) and torque of the meshes (n, 2) of some motion."""
    rng = np.random.default_rng(seed)
    u, run, load = (rng.standard_normal(shape) for shape in ((2, N), (N, 8), (N, 2)))
    run[:, 2:4] *= 30.0
    return 30.0 * u, run, 5.0 * load


def drawn(name: str, seed: int) -> Model:
    """Return the drive with an effect whose amplitudes are drawn."""
    rng, effect = np.random.default_rng(seed), CATALOGUE[name]
    values = {
        p.name: float(np.clip(rng.uniform(1.0, 3.0) * p.step, p.low, p.high))
        if p.name in effect.amplitudes
        else effect.absent()[p.name]
        for p in effect.parameters
    }
    return Model(paper_drive()).with_effect(name, **values)


def one_by_one(model, u, run, load, passes):
    """Torques (n, 3) and shifts (n, 2), sample by sample in Python."""
    ((name, values),) = model.effects.items()
    effect = CATALOGUE[name]
    kernel, p = getattr(effect.kernel, "py_func", effect.kernel), effect.values(**values)
    base, _, _ = model.arrays()
    gain, n1, n2 = base[0] * base[1], base[5], base[6]
    laws = [stribeck_law(*base[first : first + 9]) for first in (15, 15, 24)]
    torque, shift = np.zeros((N, 3)), np.zeros((N, 2))

    def brake(i, body, angle, speed, way, mesh):
        scale, added = kernel(angle, speed, (i + 0.5) * DT, mesh, body, p)
        return way * (added + (scale - 1.0) * sliding_torque(speed, way, laws[body]))

    for i in range(N):
        t, (theta, omega) = (i + 0.5) * DT, run[i, :2]
        way, carried = np.sign(omega), 0.0
        for side in (0, 1):
            turn, v = run[i, 2 + side], u[side, i]
            if effect.site == "drive":
                torque[i, side] = n1 * gain * (kernel(v, t, side, p) - v)
            if effect.site == "motor":
                torque[i, side] = n1 * kernel(v, turn, n1 * n2 * omega, t, side, p)
            if effect.site == "mesh":
                c = kernel(turn / n1, n2 * omega, theta, omega, side, p)
                shift[i, side] = c[0] - np.copysign(1.0, run[i, 6 + side]) * c[2]
            if effect.site == "friction":
                mesh = load[i, side]
                for again in range(1 + passes):
                    if again:
                        mesh = load[i, side] + torque[i, side]
                    torque[i, side] = -brake(i, side, turn / n1, n2 * omega, way, mesh)
                carried += abs(mesh)
        if effect.site == "friction":
            torque[i, 2] = -brake(i, 2, theta, omega, way, carried)
        if effect.site == "load":
            torque[i, 2] = kernel(theta, omega, t, p)
    return torque, shift


@pytest.mark.parametrize("passes", [0, 3])
@pytest.mark.parametrize("name", NAMES)
def test_blocks_do_what_kernels_do(name, passes):
    """At each sample of whole and of part blocks, also where the mesh's torque is asked again."""
    u, run, load = recorded(1)
    model = drawn(name, 2)
    torque, shift = np.empty((N, 3)), np.empty((N, 2))
    engine().along(u, run, load, passes, DT, *model.arrays(), torque, shift)
    expected = one_by_one(model, u, run, load, passes)
    size = 1.0 + np.abs(expected[0]).max()
    np.testing.assert_allclose(torque, expected[0], rtol=0.0, atol=1e-11 * size)
    np.testing.assert_allclose(shift, expected[1], rtol=0.0, atol=1e-13)
    assert max(np.abs(torque).max(), np.abs(shift).max()) > 0.0


@pytest.mark.parametrize("exponent", [1.0, 1.7])
def test_friction_of_sliding_is_the_laws(exponent):
    """With an exponent that is a power, and with the one that is none."""
    base, _, _ = Model(paper_drive()).arrays()
    law = np.array([*base[15:23], exponent])
    speed = np.linspace(-0.5, 0.5, N)
    out = np.empty(N)
    engine().sliding_along(speed, law, out)
    ways = np.where(speed > 0.0, 1.0, -1.0)
    own = stribeck_law(*law)
    expected = [-way * sliding_torque(v, way, own) for v, way in zip(speed, ways, strict=True)]
    np.testing.assert_allclose(out, expected, rtol=1e-13)


def test_presliding_begins_anew_with_each_record():
    """Two records one after another are what each is alone."""
    base, _, _ = Model(paper_drive()).arrays()
    law, rng = np.array(base[15:24]), np.random.default_rng(3)
    speed = np.cumsum(rng.standard_normal(N))
    angle = 1e-3 * np.cumsum(speed)

    def rubbed(part, begins):
        out = np.empty(part.stop - part.start)
        engine().sliding_along(speed[part].copy(), law, out)
        given = speed[part].copy(), angle[part].copy(), np.array(begins), 0.02, 0.5, law, out
        engine().presliding_along(*given)
        return out

    both = rubbed(slice(0, N), [0, 90])
    parts = [rubbed(slice(0, 90), [0]), rubbed(slice(90, N), [0])]
    np.testing.assert_array_equal(both, np.concatenate(parts))
    assert not np.allclose(both, rubbed(slice(0, N), [0]))
