"""What effects and friction do along a recorded motion, against kernels sample by sample."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law
from dmptm_ctrl.identify.disturbance import PASSES, course, disturbance
from dmptm_ctrl.simulate.along import (
    acting_in,
    built_up_along,
    delayed_along,
    lagged_along,
    law_along,
    reading_along,
)
from dmptm_ctrl.simulate.model import Model

N, DT = 203, 1e-3
SITES = ("amplifier", "motor", "mesh", "friction", "load")
NAMES = [name for name, effect in CATALOGUE.items() if effect.site in SITES]


def recorded(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voltages (2, n), run (n, 8) and torque of the meshes (2, n) of some motion."""
    rng = np.random.default_rng(seed)
    u, run, load = (rng.standard_normal(shape) for shape in ((2, N), (N, 8), (2, N)))
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
    """Torques (3, n) and shifts (2, n), sample by sample in Python."""
    ((name, values),) = model.effects.items()
    effect = CATALOGUE[name]
    kernel, p = getattr(effect.kernel, "py_func", effect.kernel), effect.values(**values)
    plant, (n1, n2) = model.plant(), (model.drive[name] for name in ("N_1", "N_2"))
    gain = model.drive["K_d"] * model.drive["K_M"]
    laws = [stribeck_law(*plant.law[body]) for body in range(3)]
    torque, shift = np.zeros((3, N)), np.zeros((2, N))

    def brake(i, body, angle, speed, way, mesh):
        scale, added = kernel(angle, speed, (i + 0.5) * DT, mesh, body, p)
        law = sliding_torque(speed, way, laws[body])
        return way * (scale * (added + law) - law)

    for i in range(N):
        t, (theta, omega) = (i + 0.5) * DT, run[i, :2]
        way, carried = np.sign(omega), 0.0
        for side in (0, 1):
            turn, v = run[i, 2 + side], u[side, i]
            if effect.site == "amplifier":
                torque[side, i] = n1 * gain * (kernel(v, t, side, p) - v)
            if effect.site == "motor":
                torque[side, i] = n1 * kernel(v, turn, n1 * n2 * omega, t, side, p)
            if effect.site == "mesh":
                c = kernel(turn / n1, n2 * omega, theta, omega, side, p)
                shift[side, i] = c[0] - np.copysign(1.0, run[i, 6 + side]) * c[2]
            if effect.site == "friction":
                mesh = load[side, i]
                for again in range(1 + passes):
                    if again:
                        mesh = load[side, i] + torque[side, i]
                    torque[side, i] = -brake(i, side, turn / n1, n2 * omega, way, mesh)
                carried += abs(mesh)
        if effect.site == "friction":
            torque[2, i] = -brake(i, 2, theta, omega, way, carried)
        if effect.site == "load":
            torque[2, i] = kernel(theta, omega, t, p)
    return torque, shift


def filled(rows):
    """Rows as an array, those that are none zero."""
    return np.array([np.zeros(N) if row is None else row for row in rows])


@pytest.mark.parametrize("carries", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_loops_do_what_kernels_do(name, carries):
    """At each sample, also where the mesh's torque is asked again."""
    u, run, load = recorded(1)
    if not carries:
        load = np.zeros_like(load)
    model = drawn(name, 2)
    way = course([u], [run], DT)
    torque, shift, _ = disturbance(way, model.plant(), load if carries else None)
    expected = one_by_one(model, u, run, load, PASSES if carries else 0)
    size = 1.0 + np.abs(expected[0]).max()
    np.testing.assert_allclose(filled(torque), expected[0], rtol=0.0, atol=1e-11 * size)
    np.testing.assert_allclose(filled(shift), expected[1], rtol=0.0, atol=1e-13)
    if carries or name != "load_dependent_friction":
        assert max(np.abs(filled(torque)).max(), np.abs(filled(shift)).max()) > 0.0


@pytest.mark.parametrize("name", ["drive_delay", "current_lag", "cogging", "thermal_drift"])
def test_motions_one_after_another_are_what_each_is_alone(name):
    u, run, _ = recorded(4)
    model, parts = drawn(name, 5), (slice(0, 90), slice(90, N))
    both = course([u[:, p] for p in parts], [run[p] for p in parts], DT)
    together = filled(disturbance(both, model.plant()).torque)
    for p in parts:
        torque = disturbance(course([u[:, p]], [run[p]], DT), model.plant()).torque
        for row, own in zip(together, torque, strict=True):
            if own is not None:
                np.testing.assert_array_equal(row[p], own)


def test_sensor_reads_what_its_kernel_says():
    _, run, _ = recorded(6)
    model = drawn("sensor_gain", 7)
    effects = acting_in(model.plant())
    seen = reading_along(effects["sensor", 0], *run.T[:2].copy(), DT * np.arange(N))
    effect = CATALOGUE["sensor_gain"]
    p = effect.values(**model.effects["sensor_gain"])
    expected = [effect.kernel.py_func(*run[i, :2], DT * i, p) for i in range(N)]
    np.testing.assert_allclose(np.transpose(seen), expected, rtol=1e-14)


@pytest.mark.parametrize("exponent", [1.0, 1.7])
def test_friction_of_sliding_is_the_laws(exponent):
    """With an exponent that is a power, and with the one that is none."""
    law = np.array([*Model(paper_drive()).plant().law[0, :8], exponent])
    speed = np.linspace(-0.5, 0.5, N)
    ways = np.where(speed > 0.0, 1.0, -1.0)
    own = stribeck_law(*law)
    expected = [way * sliding_torque(v, way, own) for v, way in zip(speed, ways, strict=True)]
    np.testing.assert_allclose(law_along(speed, law), expected, rtol=1e-13)


def test_presliding_begins_anew_with_each_record():
    """Two records one after another are what each is alone."""
    law, rng = Model(paper_drive()).plant().law[0], np.random.default_rng(3)
    speed = np.cumsum(rng.standard_normal(N))
    travel = 1e-3 * speed

    def rubbed(part, begins):
        omega = speed[part].copy()
        given = omega, travel[part].copy(), np.array(begins), (0.02, 0.5), law
        return built_up_along(law_along(omega, law), *given)

    both = rubbed(slice(0, N), [0, 90])
    parts = [rubbed(slice(0, 90), [0]), rubbed(slice(90, N), [0])]
    np.testing.assert_array_equal(both, np.concatenate(parts))
    assert not np.allclose(both, rubbed(slice(0, N), [0]))


def test_presliding_builds_up_as_dahls_equation():
    """Along a motion to and fro, of Coulomb friction alone: dF/dx = (Tc − F sgn v) Tc/x0 / Tc."""
    coulomb, distance = 2.0, 0.02
    law = np.array([coulomb, coulomb, 1.0, 0.0, coulomb, coulomb, 1.0, 0.0, 1.0])
    t = DT * np.arange(N)
    angle, speed = 0.05 * np.sin(20.0 * t), np.cos(20.0 * t)
    level = law_along(speed, law)
    travel = np.diff(angle, prepend=0.0)
    built = built_up_along(level, speed, travel, np.zeros(1, int), (distance, 0.0), law)

    def dahl(time, force):
        rate = np.cos(20.0 * time)
        return (coulomb * np.sign(rate) - force) * abs(rate) / distance

    exact = solve_ivp(dahl, (0.0, t[-1]), [0.0], t_eval=t, max_step=DT, rtol=1e-8)
    # a sample in which the motion turns moves less than a millionth of the distance
    np.testing.assert_allclose(built, exact.y[0], atol=2e-3 * coulomb)


@pytest.mark.parametrize("samples", [0.3, 1.0, 4.0, 5.75, 500.0])
def test_delay_is_the_mean_of_what_was_held(samples):
    """By integration of the held signal, for delays of whole and of part samples."""
    u, before = np.random.default_rng(8).standard_normal(N), 0.7
    edges = np.arange(N + 1) - samples
    past = np.concatenate([[0.0], np.cumsum(u)])
    passed = np.interp(edges, np.arange(N + 1), past) + np.minimum(edges, 0.0) * before
    expected = np.diff(passed)
    np.testing.assert_allclose(delayed_along(u, samples, before), expected, atol=1e-12)


def test_lag_is_its_differential_equation():
    """Mean over each sample of τ dx/dt = u − x, x and its integral solved by another method."""
    rng = np.random.default_rng(9)
    u, tau, before = rng.standard_normal(40), 3e-3, -0.4
    state, expected = before, []
    for aim in u:
        more = solve_ivp(
            lambda _, x, aim=aim: [(aim - x[0]) / tau, x[0]],
            (0.0, DT), [state, 0.0], method="DOP853", rtol=1e-12, atol=1e-14,
        )  # fmt: skip
        state = more.y[0, -1]
        expected.append(more.y[1, -1] / DT)
    np.testing.assert_allclose(lagged_along(u, np.full(40, tau), DT, before), expected, atol=1e-11)
