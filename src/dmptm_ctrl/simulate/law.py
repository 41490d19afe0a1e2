"""What a controller is to the simulator: its numbers, and the model it feeds forward from."""

import ast
import inspect
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from typing import Any

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import lookup, presliding, stribeck
from dmptm_ctrl.simulate import control_core as core
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.dual import catalogue, per_catalogue
from dmptm_ctrl.simulate.loading import key_of, load
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.plant import Flags, Floats
from dmptm_ctrl.simulate.run import Controller

PASS = (1.0, 0.0, 0.0, 0.0, 0.0)  # a section that changes nothing
FAR = 1e9  # rad/s², no limit
SECTIONS = 2
# per site: name of its chain, its arguments, how it begins, what one effect changes, its result
_CHAINS = {
    "drive": ("drive_voltage", "u, t, side", "", "u = {call}", "u"),
    "motor": ("motor_torque", "u, theta_m, omega_m, t, side", "r = 0.0", "r += {call}", "r"),
    "friction": (
        "friction_level",
        "theta, omega, t, mesh_torque, body",
        "r = (1.0, 0.0)",
        "c = {call}; r = (r[0] * c[0], r[1] + c[1])",
        "r",
    ),
    "presliding": (
        "presliding_law",
        "body",
        "r = (0.0, 0.0, 0.0)",
        "c = {call}; r = (r[0] + c[0], max(r[1], c[1]), max(r[2], c[2]))",
        "r",
    ),
    "load": ("load_torque", "theta_L, omega_L, t", "r = 0.0", "r += {call}", "r"),
    "sensor": (
        "sensor_reading",
        "theta_L, omega_L, t",
        "",
        "theta_L, omega_L = {call}",
        "theta_L, omega_L",
    ),
}
_HEAD = """\
from math import cos, exp, floor, log, sin, sqrt, tanh

import numpy as np
from functools import partial

from numba import njit

from dmptm_ctrl.effects import presliding, stribeck
from dmptm_ctrl.simulate.elementary import exp, FAST, hosted
from dmptm_ctrl.simulate.run import compiled_controller

stribeck_law, sliding_torque = hosted(stribeck.stribeck_law), hosted(stribeck.sliding_torque)
viscous_torque = hosted(stribeck.viscous_torque)
build_up_distance = hosted(presliding.build_up_distance)
"""
_TAIL = """\
@partial(compiled_controller, cache=True)
def controller(i, t, dt, target, noise, y, rule, memory, u):
    design = rule[{0}:{1}], rule[{1}:{2}], rule[{2}:]
    command(target, y[0], y[1] + noise, y[2], y[3], t, dt, rule, memory, design)
    u[0], u[1] = memory[M_LEFT], memory[M_RIGHT]
"""


def _chain(site: str, effects: tuple[Effect, ...]) -> str:
    """Text of the kernels of a site one after another, each behind its flag."""
    name, args, start, change, result = _CHAINS[site]
    lines = [f"@njit\ndef {name}({args}, on, values):", f"    {start}" * bool(start)]
    for effect in (e for e in effects if e.site == site):
        flag, first = catalogue().slots[effect.name]
        values = ", ".join(f"values[{first + j}]" for j in range(len(effect.parameters)))
        call = f"kernel_{flag}({args}, Values_{flag}({values}))"
        lines += [f"    if on[{flag}]:", *(f"        {part}" for part in
                  change.format(call=call).split("; "))]  # fmt: skip
    return "\n".join([*lines, f"    return {result}"])


def _own_text() -> str:
    """Text of `control_core` behind what it only names."""
    text = inspect.getsource(core)
    named = [n for n in ast.parse(text).body if isinstance(n, ast.ImportFrom | ast.AnnAssign)]
    return "".join(text.splitlines(keepends=True)[named[-1].end_lineno :])


@per_catalogue
def law_engine(effects: tuple[Effect, ...]) -> Any:
    """Return the compiled law for the catalogue as it is now."""
    kernels = "\n".join(
        f"kernel_{i} = hosted(EFFECTS[{i}].kernel)\nValues_{i} = EFFECTS[{i}].values"
        for i, effect in enumerate(effects)
        if effect.site in _CHAINS
    )
    used = (
        " or ".join(f"on[{i}] > 0" for i, e in enumerate(effects) if e.site == site) or "False"
        for site in ("motor", "friction", "load")
    )
    chains = [f"@njit\ndef active_sites(on):\n    return {', '.join(used)}"]
    chains += [_chain(site, effects) for site in _CHAINS]
    size = len(paper_drive())
    ends = core.L_SIZE, core.L_SIZE + size, core.L_SIZE + size + len(effects)
    text = "\n\n".join([_HEAD, kernels, *chains, _own_text(), _TAIL.format(*ends)])
    options = 'cache=True, error_model="numpy", nogil=True, fastmath=FAST'
    text = text.replace("@njit\n", f"@njit({options})\n")
    key = key_of(text, (elementary, lookup, presliding, stribeck), effects)
    return load(f"law_{key}", text, "the controllers of the dual-motor drive", EFFECTS=effects)


def design_of(model: Model) -> tuple[Floats, Flags, Floats]:
    """Return a design model as `control_core` takes it: the drive, flags and numbers of effects."""
    plant, effects = model.plant(), catalogue()
    numbers = np.array([q.value for q in model.drive.quantities.values()])
    return numbers, plant.on[: len(effects.slots)], plant.values[: effects.absent.size]


@dataclass(frozen=True)
class Design:
    """What a designed controller and the law that the simulator runs have in common.

    Attributes
    ----------
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    limit : float [V]
        Of each motor's voltage.
    tracking : float [1/s]
        Anti-windup by back-calculation: rate at which the integral gives back what the limit
        cuts off; 0 is none.
    inertia, friction, effects : float
        Shares fed forward along the setpoint from `model`: inertia; friction of all three
        bodies with the effects on it; torques of motor and load effects. 0 is off.
    lead : float [s]
        How far ahead the feed-forward looks: dead times and lags of the drive.
    late : float [s]
        How late the speed reading is: the error is taken against the setpoint back then.
    acceleration : float [rad/s²]
        Largest acceleration of the setpoint that is fed forward; steps are clipped to it.
    softness : float [rad/s]
        Below this setpoint speed the friction fed forward fades to 0.
    invert : bool
        Undo offset, dead band and gain errors of the drives.
    model : Model
        What is fed forward and undone.
    """

    kp: float
    ki: float
    limit: float = 10.0
    _: KW_ONLY
    tracking: float = 0.0
    inertia: float = 0.0
    friction: float = 0.0
    effects: float = 0.0
    lead: float = 0.0
    late: float = 0.0
    acceleration: float = FAR
    softness: float = 0.0
    invert: bool = False
    model: Model = field(default_factory=Model)

    def shared(self) -> dict[str, Any]:
        """Return the fields above, as keywords of another of its kind."""
        return {part.name: getattr(self, part.name) for part in fields(Design)}


@dataclass(frozen=True)
class Law(Design):
    """A sampled speed controller with its design model, as the simulator takes it.

    Attributes
    ----------
    bias_l, bias_r : float [V]
        Preload.
    sections : sequence of (b0, b1, b2, a1, a2)
        Up to two second-order difference equations behind the PI.
    relief : (from, to) [V]
        The preload fades between these common voltages; (0, 0) keeps it.
    """

    bias_l: float = 0.0
    bias_r: float = 0.0
    sections: Sequence[tuple[float, ...]] = ()
    relief: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if len(self.sections) > SECTIONS:
            raise ValueError(f"{len(self.sections)} sections, the loop has room for {SECTIONS}")

    def numbers(self) -> Floats:
        """Return the (SIZE,) vector of `control_core`."""
        filled = [*self.sections, *[PASS] * (SECTIONS - len(self.sections))]
        return np.array(
            [
                *(self.kp, self.ki, self.limit, self.bias_l, self.bias_r, 2.0, self.tracking),
                *(float(x) for part in filled for x in part),
                *(self.inertia, self.friction, self.effects, self.lead, self.late),
                *(self.acceleration, self.softness, float(self.invert)),
                *self.relief,
            ]
        )

    def controller(self) -> Controller:
        """Return the law as the compiled loop calls it."""
        rule = np.concatenate([self.numbers(), *design_of(self.model)])
        return Controller(law_engine().controller, rule, core.MEMORY)

    def stepper(self, sample_time: float) -> "Stepper":
        """Return the controller as a difference equation to be advanced sample by sample."""
        return Stepper(self, sample_time)


class Stepper:
    """A running controller.

    ``stepper(ref, theta_L, omega_L, theta_ml, theta_mr)`` takes SI readings of one sample
    and returns the voltages (left, right). It is the code that the simulated loop runs.
    """

    def __init__(self, law: Law, sample_time: float) -> None:
        self._law, self._dt = law.numbers(), sample_time
        self._design = design_of(law.model)
        self._command = law_engine().command
        self._memory = np.zeros(core.MEMORY)
        self._samples = 0

    def __call__(
        self, ref: float, theta_L: float, omega_L: float, theta_ml: float, theta_mr: float
    ) -> tuple[float, float]:
        self._command(
            *(ref, theta_L, omega_L, theta_ml, theta_mr, self._samples * self._dt, self._dt),
            *(self._law, self._memory, self._design),
        )
        self._samples += 1
        return float(self._memory[core.M_LEFT]), float(self._memory[core.M_RIGHT])
