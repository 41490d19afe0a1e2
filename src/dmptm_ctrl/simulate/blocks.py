"""The drive as python-control blocks, one per component, joined by their signal names.

No physics here: each block calls the kernels of its site. Blocks are pure functions of
(t, x, u, params), finite at zero, without memory besides their states. Of `params` they take
values of the declared drive and of the loop by name, and refuse other names.

Friction with real sticking inside an ODE (Karnopp, J. Dyn. Sys. 107 (1985) 100): below
:data:`REST_SPEED` a body counts as resting; its friction then takes the value that balances
the net torque, as long as the breakaway torque allows, and the body does not move: angle
and speed keep their values. There is no smoothed sign, so nothing creeps. What the band
costs is a residual speed below REST_SPEED. A body without dry friction never rests, so that
``control.linearize`` at rest finds its viscous friction.

A dead time in an ODE is a Padé approximation (order :data:`PADE_ORDER`); the compiled
simulator and the reference have it exactly.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from dmptm_ctrl.effects.backlash import gap_rate, twist_torque
from dmptm_ctrl.simulate.base import Floats, refuse_negative
from dmptm_ctrl.simulate.block_params import Given, given_of
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop
from dmptm_ctrl.simulate.plain import RING, Sites

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model

REST_SPEED = 1e-5  # rad/s; a hundredth of the gyro's noise, far above a solver's tolerance
PADE_ORDER = 4  # phase error below 1° up to ω T_d = 4.5 rad
MAX_STEP = 0.01  # s; so that no turn of the motion is stepped over
SIDES = ("l", "r")
CONTACTS = ("memoryless", "two_state")


class _Delay:
    """A dead time as Padé states; a plain wire without delay."""

    def __init__(self, delay: float, order: int) -> None:
        self.order = order if delay > 0.0 else 0
        if self.order:  # realised for unit delay, so that the realisation is well scaled
            unit = ct.ss(ct.tf(*ct.pade(1.0, order)))
            self.A, self.B = unit.A / delay, unit.B[:, 0] / delay
            self.C, self.D = unit.C[0], float(unit.D[0, 0])
        self.states = [f"delay_{i}" for i in range(self.order)]

    def rate(self, x, u: float) -> Floats:
        return self.A @ x + self.B * u if self.order else np.zeros(0)

    def output(self, x, u: float) -> float:
        return float(self.C @ x) + self.D * u if self.order else u

    def settled(self, u: float) -> Floats:
        """States after `u` was held for long."""
        return np.linalg.solve(self.A, -self.B * u) if self.order else np.zeros(0)


def drive_block(
    model: "Model | Given", side: int, *, pade_order: int = PADE_ORDER
) -> ct.NonlinearIOSystem:
    """Return the drive of one motor: dead time, static effects, lag.

    Input u_left or u_right [V], output voltage_l or voltage_r [V], what the motor gets.
    """
    given = given_of(model)
    late, lagged = _Delay(given.sites.voltage_delay, pade_order), given.sites.lag > 0.0
    order = late.order

    def target(sites, t, x, u):
        return sites.drive_voltage(late.output(x[:order], float(u[0])), t, side)

    def update(t, x, u, params):
        sites = given.at(params).sites
        rate = late.rate(x[:order], u[0])
        if lagged:
            rate = np.append(rate, sites.lag_rate(x[order], target(sites, t, x, u), side))
        return rate

    def output(t, x, u, params):
        return [x[order] if lagged else target(given.at(params).sites, t, x, u)]

    return ct.NonlinearIOSystem(
        update,
        output,
        inputs=[("u_left", "u_right")[side]],
        outputs=[f"voltage_{SIDES[side]}"],
        states=late.states + ["lag"] * lagged,
        name=f"drive_{SIDES[side]}",
    )


def drive_states(
    model: "Model", side: int, u: float, *, pade_order: int = PADE_ORDER
) -> dict[str, float]:
    """Return the states of the drive, by their name in `to_blocks`, once `u` [V] has lasted."""
    sites, block = Sites(model), f"drive_{SIDES[side]}"
    late = _Delay(sites.voltage_delay, pade_order)
    states = dict(zip(late.states, late.settled(u), strict=True))
    if sites.lag > 0.0:
        target = sites.drive_voltage(u, 0.0, side)
        states["lag"] = sites.lag_rate(0.0, target, side) * sites.lag
    return {f"{block}_{name}": float(x) for name, x in states.items()}


def mesh_block(
    model: "Model | Given", side: int, *, contact: str = "memoryless"
) -> ct.NonlinearIOSystem:
    """Return the mesh of one pinion with the ring gear.

    Inputs theta_3, omega_3 of the pinion and ring_angle, ring_speed; outputs torque
    [N·m], positive drives the ring gear, and z = θ3 − N2 θL [rad]. With the two-state contact
    law the position in the gap [rad] is a state; the other law has none.

    Raises
    ------
    ValueError
        A contact law that does not exist; the two-state law without any damping.
    """
    given, s = given_of(model), SIDES[side]

    def output(t, x, u, params):
        sites = given.at(params).sites
        theta, omega, ring_angle, ring_speed = u.tolist()
        torque = sites.mesh_torque(theta, omega, ring_angle, ring_speed, side)
        return [torque, theta - sites.n2 * ring_angle]

    def placed(x, u, params):
        z, rate, law = given.at(params).sites.mesh(*u.tolist(), side)
        return min(max(float(x[0]), -law.half_gap), law.half_gap), z, rate, law

    def two_state(t, x, u, params):
        angles = u.tolist()
        n2 = given.at(params).sites.n2
        return [twist_torque(*placed(x, u, params)), angles[0] - n2 * angles[2]]

    if contact not in CONTACTS:
        raise ValueError(f"contact is {contact!r}; it must be one of {', '.join(CONTACTS)}")
    stateful = contact == "two_state"
    if stateful and given.model.drive["c"] + given.model.drive["c_f"] <= 0.0:
        raise ValueError("c + c_f is 0: nothing tells where in its gap an undamped tooth is")
    return ct.NonlinearIOSystem(
        (lambda t, x, u, params: [gap_rate(*placed(x, u, params))]) if stateful else None,
        two_state if stateful else output,
        inputs=[f"theta_3{s}", f"omega_3{s}", "ring_angle", "ring_speed"],
        outputs=[f"torque_{s}", f"z_{s}"],
        states=["position"] if stateful else None,
        name=f"mesh_{s}",
    )


def friction_states(sites: Sites, body: int) -> list[str]:
    """Return the names of the states that friction of a body has."""
    presliding, ageing = sites.distances[body] > 0.0, sites.renewals[body] > 0.0
    return ["friction"] * presliding + ["age"] * ageing


def friction_block(model: "Model | Given", body: int) -> ct.NonlinearIOSystem:
    """Return the friction of one body: of a reducer (0, 1), or of the load (2).

    Inputs angle [rad] and speed [rad/s] of the body, the net torque [N·m] that friction meets,
    and the torques of its meshes. Outputs friction [N·m], against positive motion, and held: 1
    while it holds the body at rest, else 0.
    """
    given = given_of(model)
    place = "L" if body == RING else SIDES[body]
    motion = (
        ["ring_angle", "ring_speed"] if body == RING else [f"theta_3{place}", f"omega_3{place}"]
    )
    meshes = [f"torque_{s}" for s in (SIDES if body == RING else place)]
    presliding, ageing = given.sites.distances[body] > 0.0, given.sites.renewals[body] > 0.0

    def laws(t, x, u, params):
        """Friction, held, and the torque that presliding builds up to."""
        sites, (theta, omega, net, *torques) = given.at(params).sites, u.tolist()
        carried = sum(map(abs, torques)) if body == RING else torques[0]
        age = float(x[-1]) if ageing else 0.0
        if presliding:
            direction = 1.0 if omega >= 0.0 else -1.0
            at = direction, theta, omega, t, carried, age
            at_once = direction * sites.at_once(body, *at)
            level = direction * sites.sliding(body, *at) - at_once
            built_up = sites.build_up(body, omega, level, float(x[0]))
            damping = sites.bristle_damping(body, direction, omega, built_up)
            return float(x[0]) + at_once + damping, 0.0, built_up
        if abs(omega) <= REST_SPEED:
            direction = 1.0 if net > 0.0 else -1.0
            most = sites.holding(body, direction, theta, t, carried, age)
            if most > 0.0:
                held = abs(net) <= most
                return (net if held else direction * most), float(held), 0.0
        direction = 1.0 if omega > 0.0 else -1.0
        return direction * sites.sliding(body, direction, theta, omega, t, carried, age), 0.0, 0.0

    def update(t, x, u, params):
        rates = [laws(t, x, u, params)[2]] if presliding else []
        if ageing:
            rates.append(given.at(params).sites.ageing(body, u[1], x[-1]))
        return rates

    states = friction_states(given.sites, body)
    return ct.NonlinearIOSystem(
        update if states else None,
        lambda t, x, u, params: laws(t, x, u, params)[:2],
        inputs=[*motion, f"net_{place}", *meshes],
        outputs=[f"friction_{place}", f"held_{place}"],
        states=states or None,
        name=f"friction_{place}",
    )


def _moved(omega: float, net: float, friction: float, held: float, inertia: float) -> list[float]:
    """Rates of angle and speed of a body."""
    return [0.0, 0.0] if held else [omega, (net - friction) / inertia]


def rig_block(model: "Model | Given", side: int) -> ct.NonlinearIOSystem:
    """Return motor, reducer and pinion of one side.

    Inputs voltage [V], torque of the mesh, friction [N·m] and held; outputs theta_m, omega_m of
    the motor, theta_3, omega_3 of the pinion [rad, rad/s], and net, the torque that friction
    meets [N·m]. The motor has states of its own where the reducer is compliant.
    """
    given, s = given_of(model), SIDES[side]
    elastic = given.sites.compliance > 0.0

    def motor(x):
        return x[2:4] if elastic else x[:2]

    def torques(sites, t, x, u):
        """Of the motor, and on the pinion without friction."""
        theta, omega = motor(x)
        drive = sites.motor_torque(u[0], sites.n1 * theta, sites.n1 * omega, t, side)
        if not elastic:
            return drive, drive
        shaft = (theta - x[0]) / sites.compliance + sites.shaft_damping * (omega - x[1])
        return drive, shaft

    def update(t, x, u, params):
        sites, x, u = given.at(params).sites, x.tolist(), u.tolist()
        inertia = sites.pinion_inertia + (0.0 if elastic else sites.motor_inertia)
        drive, shaft = torques(sites, t, x, u)
        rates = _moved(x[1], shaft - u[1], u[2], u[3], inertia)
        return [*rates, x[3], (drive - shaft) / sites.motor_inertia] if elastic else rates

    def output(t, x, u, params):
        sites, x, u = given.at(params).sites, x.tolist(), u.tolist()
        theta, omega = motor(x)
        net = torques(sites, t, x, u)[1] - u[1]
        return [sites.n1 * theta, sites.n1 * omega, x[0], x[1], net]

    return ct.NonlinearIOSystem(
        update,
        output,
        inputs=[f"voltage_{s}", f"torque_{s}", f"friction_{s}", f"held_{s}"],
        outputs=[f"theta_m{s}", f"omega_m{s}", f"theta_3{s}", f"omega_3{s}", f"net_{s}"],
        states=["theta", "omega"] + ["theta_motor", "omega_motor"] * elastic,
        name=f"chain_{s}",
    )


def ring_block(model: "Model | Given") -> ct.NonlinearIOSystem:
    """Return the ring gear with the load's effects.

    Inputs torque_l, torque_r at the pinions, friction_L [N·m] and held_L; outputs ring_angle
    [rad], ring_speed [rad/s], the true ones, and net_L, the torque that friction meets [N·m].
    """
    given = given_of(model)

    def net(sites, t, x, u):
        return sites.n2 * (u[0] + u[1]) + sites.load_torque(x[0], x[1], t)

    def update(t, x, u, params):
        sites, x, u = given.at(params).sites, x.tolist(), u.tolist()
        return _moved(x[1], net(sites, t, x, u), u[2], u[3], sites.ring_inertia)

    def output(t, x, u, params):
        return [x[0], x[1], net(given.at(params).sites, t, x.tolist(), u.tolist())]

    return ct.NonlinearIOSystem(
        update,
        output,
        inputs=["torque_l", "torque_r", "friction_L", "held_L"],
        outputs=["ring_angle", "ring_speed", "net_L"],
        states=["theta", "omega"],
        name="ring",
    )


def sensor_block(model: "Model | Given", *, pade_order: int = PADE_ORDER) -> ct.NonlinearIOSystem:
    """Return the sensors: ring_angle, ring_speed in, the readings theta_L, omega_L out."""
    given = given_of(model)
    late = _Delay(given.sites.speed_delay, pade_order)

    def output(t, x, u, params):
        sites = given.at(params).sites
        return sites.reading(float(u[0]), late.output(x, float(u[1])), t)

    return ct.NonlinearIOSystem(
        lambda t, x, u, params: late.rate(x, u[1]),
        output,
        inputs=["ring_angle", "ring_speed"],
        outputs=["theta_L", "omega_L"],
        states=late.states,
        name="sensor",
    )


def pi_block(loop: Loop | Given) -> ct.NonlinearIOSystem:
    """Return the PI speed loop in continuous time, G_c = kp + ki/s, with clip and preload.

    Inputs ref, omega_L [rad/s], outputs u_left, u_right [V]; state ∫(ref − omega_L) dt.
    Source: paper section 4.3; sampled at 1 kHz in the rig, see `compiled.close_loop`.
    """
    given = loop if isinstance(loop, Given) else Given(None, loop)

    def output(t, x, u, params):
        loop = given.at(params).loop
        common = loop.kp * (u[0] - u[1]) + loop.ki * x[0]
        common = min(max(common, -loop.limit), loop.limit)
        return [common + loop.bias_l, common + loop.bias_r]

    return ct.NonlinearIOSystem(
        lambda t, x, u, params: [u[0] - u[1]],
        output,
        inputs=["ref", "omega_L"],
        outputs=["u_left", "u_right"],
        states=["integral"],
        name="pi",
    )


def to_blocks(
    model: "Model",
    *,
    loop: Loop | None = None,
    pade_order: int = PADE_ORDER,
    contact: str = "memoryless",
    others: Sequence[str] = (),
) -> ct.InterconnectedSystem:
    """Return the drive as python-control blocks joined by name.

    Parameters
    ----------
    model : Model
    loop : Loop, optional
        Close the speed loop, in continuous time.
    pade_order : int
        Order of the Padé approximation of a drive or sensor delay.
    contact : {"memoryless", "two_state"}
        Contact law of the meshes: paper Eq. 21, or its two-state original, which has the
        position in each gap as a state.
    others : sequence of str
        Names of `params` that belong to blocks of your own beside these.

    Returns
    -------
    InterconnectedSystem
        Inputs u_left, u_right [V], or ref [rad/s] with a loop; outputs
        :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS` in SI, and u_left, u_right with a loop.

    Raises
    ------
    ValueError
        A contact law that does not exist, or an effect of negative size.

    Notes
    -----
    ``params={"k_m": 3e4}`` in ``control.input_output_response`` and the like replaces values
    of the declared drive, and kp, ki, limit, bias_l, bias_r of the loop; other names raise
    ValueError. :func:`initial_state` gives its state at rest or in motion. With
    ``control.input_output_response`` set ``solve_ivp_kwargs={"max_step": dt}`` for inputs
    sampled at dt, or short pulses are stepped over; it draws inputs as straight lines
    between samples, :func:`dmptm_ctrl.simulate.simulate` holds them.
    """
    refuse_negative(model)
    given = Given(model, loop, others)
    blocks = [
        *(drive_block(given, side, pade_order=pade_order) for side in (0, 1)),
        *(rig_block(given, side) for side in (0, 1)),
        *(mesh_block(given, side, contact=contact) for side in (0, 1)),
        ring_block(given),
        *(friction_block(given, body) for body in (0, 1, RING)),
        sensor_block(given, pade_order=pade_order),
    ]
    inputs, outputs = ["u_left", "u_right"], list(OUTPUTS)
    if loop is not None:
        blocks.append(pi_block(given))
        inputs, outputs = ["ref"], [*outputs, "u_left", "u_right"]
    return ct.interconnect(
        blocks,
        inputs=inputs,
        outputs=outputs,
        name="drive_loop" if loop is not None else "drive",
        check_unused=False,  # omega_m of the motors is for whoever wants it
    )


def initial_state(model: "Model", sys: ct.InterconnectedSystem, x0: ArrayLike) -> Floats:
    """Return the state of `sys` from :func:`to_blocks` for a state of the three bodies.

    Parameters
    ----------
    model : Model
        Of which `sys` was made.
    sys : InterconnectedSystem
    x0 : (6,) array
        θ3l, θ3r, θL [rad] and their speeds [rad/s]; motors turn with their pinions. No
        voltage before the start; a late speed sensor has seen this speed for long.
    """
    bodies = np.asarray(x0, float)
    known = {"ring_theta": bodies[2], "ring_omega": bodies[5]}
    for side, s in enumerate(SIDES):
        known[f"chain_{s}_theta"] = known[f"chain_{s}_theta_motor"] = bodies[side]
        known[f"chain_{s}_omega"] = known[f"chain_{s}_omega_motor"] = bodies[3 + side]
        twist = bodies[side] - model.drive["N_2"] * bodies[2]
        half_gap = model.drive[f"gap_{s}"]
        known[f"mesh_{s}_position"] = min(max(twist, -half_gap), half_gap)
    stored = [label for label in sys.state_labels if label.startswith("sensor_delay")]
    late = _Delay(Sites(model).speed_delay, len(stored))
    known.update(zip(stored, late.settled(bodies[5]), strict=True))
    return np.array([known.get(label, 0.0) for label in sys.state_labels])


def run(
    model: "Model",
    u: Floats,
    x0: Floats,
    dt: float,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    pade_order: int = PADE_ORDER,
    contact: str = "memoryless",
) -> Floats:
    """Run :func:`to_blocks` on held voltages, restarted at each of their jumps.

    Parameters and result as of :func:`dmptm_ctrl.simulate.reference.simulate`; `rtol`,
    `atol` [rad, rad/s] of SciPy's RK45; `contact` as of :func:`to_blocks`.

    Raises
    ------
    RuntimeError
        The integrator gave up.
    """
    sys = to_blocks(model, pade_order=pade_order, contact=contact)
    state = initial_state(model, sys, x0)
    n = u.shape[1]
    out = np.empty((n, len(OUTPUTS)))
    jumps = np.flatnonzero(np.any(np.diff(u) != 0.0, axis=0)) + 1
    ends = sorted({*jumps.tolist(), n - 1})
    first = 0
    out[0] = sys.output(0.0, state, u[:, 0])
    for last in ends:
        held = u[:, first]
        times = np.arange(first, last + 1) * dt
        found = solve_ivp(
            lambda t, x, held=held: sys.dynamics(t, x, held),
            (times[0], times[-1]),
            state,
            t_eval=times[1:],
            rtol=rtol,
            atol=atol,
            max_step=MAX_STEP,
        )
        if not found.success:
            raise RuntimeError(f"the blocks failed at t = {found.t[-1]:.6f} s: {found.message}")
        for i, x in enumerate(found.y.T, first + 1):
            out[i] = sys.output(i * dt, x, u[:, i])
        state, first = found.y[:, -1], last
    return out
