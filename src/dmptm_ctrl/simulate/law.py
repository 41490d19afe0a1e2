"""What a controller is to the simulator: its numbers, and the model it feeds forward from."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from functools import cached_property
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.effects import lookup, presliding, stribeck
from dmptm_ctrl.simulate import control_core as core
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.any_model import loop_parts
from dmptm_ctrl.simulate.generate import compiled
from dmptm_ctrl.simulate.law_text import Wiring, law_text, wiring
from dmptm_ctrl.simulate.loading import LOADING, key_of, load
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plant import Structure, number_names, numbers, structure_of
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.run import Controller

PASS = (1.0, 0.0, 0.0, 0.0, 0.0)  # a section that changes nothing
FAR = 1e9  # rad/s², no limit
SECTIONS = 2
_ENGINES: dict[tuple[int, Wiring], ModuleType] = {}


class Wired(NamedTuple):
    """A law as code and numbers."""

    module: ModuleType  # ``command(ref, *readings, t, dt, law, memory, design)`` and ``controller``
    design: tuple[Floats, Floats, Floats]  # numbers, flags and values of what is fed forward
    wiring: Wiring
    memory: int  # room that it keeps from sample to sample


def _engine(s: Structure, w: Wiring, flags: int) -> ModuleType:
    """Return the compiled law of a structure."""
    with LOADING:
        if (id(s), w) not in _ENGINES:
            text = compiled(law_text(s, w, flags), "command")
            effects = tuple(p.effect for p in s.places)
            key = key_of(text, (core, elementary, lookup, presliding, stribeck), effects)
            what = "the controller of this drive"
            _ENGINES[id(s), w] = load(f"law_{key}", text, what, EFFECTS=effects)
        return _ENGINES[id(s), w]


@dataclass(frozen=True)
class Design:
    """What a designed controller and the law that the simulator runs have in common."""

    kp: float  # V/(rad/s)
    ki: float  # V/rad
    limit: float = 10.0  # V, of each motor
    _: KW_ONLY
    # anti-windup: rate [1/s] at which the integral gives back what the limit cuts off; 0 is none
    tracking: float = 0.0
    # Shares fed forward along the setpoint from `model`: inertia; friction of all bodies with the
    # effects on it; torques of motor and load effects. 0 is off.
    inertia: float = 0.0
    friction: float = 0.0
    effects: float = 0.0
    lead: float = 0.0  # s ahead, that the feed-forward looks: dead times and lags of the drive
    late: float = 0.0  # s, of the speed reading: the error is against the setpoint back then
    acceleration: float = FAR  # rad/s², largest that is fed forward; steps are clipped to it
    softness: float = 0.0  # rad/s; below this setpoint the friction fed forward fades to 0
    invert: bool = False  # undo offset, dead band and gain errors of the drives
    model: Model | RigModel = field(default_factory=Model)  # what is fed forward and undone
    # of a rig: the motor, and what the setpoint is of; by default `default_loop`
    input: str = ""
    sensor: str = ""

    def shared(self) -> dict[str, Any]:
        """Return the fields above, as keywords of another of its kind."""
        return {part.name: getattr(self, part.name) for part in fields(Design)}


@dataclass(frozen=True)
class Law(Design):
    """A sampled speed controller with its design model, as the simulator takes it."""

    bias_l: float = 0.0  # V, preload
    bias_r: float = 0.0
    # up to two second-order difference equations (b0, b1, b2, a1, a2) behind the PI
    sections: Sequence[tuple[float, ...]] = ()
    # V, common: the preload fades between these; (0, 0) keeps it
    relief: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if len(self.sections) > SECTIONS:
            raise ValueError(f"{len(self.sections)} notches; the loop has room for {SECTIONS}")

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

    @cached_property
    def wired(self) -> Wired:
        """The law as code and numbers; ValueError where no link joins input and sensor."""
        plant = self.model.plant()
        s = structure_of(plant, switched=True)
        w = wiring(s, *loop_parts(self.model, self.input, self.sensor))
        row = numbers(plant, number_names(s, values=False), 1.0)
        design = row, plant.on.astype(float), np.asarray(plant.values, float)
        memory = core.M_BRISTLES + s.coordinates
        return Wired(_engine(s, w, plant.on.size), design, w, memory)

    def controller(self) -> Controller:
        """Return the law as the compiled loop calls it."""
        rule = np.concatenate([self.numbers(), *self.wired.design])
        return Controller(self.wired.module.controller, rule, self.wired.memory)

    def stepper(self, sample_time: float) -> "Stepper":
        """Return the controller as a difference equation to be advanced sample by sample."""
        return Stepper(self, sample_time)


class Stepper:
    """A running controller.

    ``stepper(ref, *readings)`` takes SI readings of one sample, of the dual-motor drive ``theta_L,
    omega_L, theta_ml, theta_mr``, and returns the signals of the inputs. It is the code that the
    simulated loop runs.
    """

    def __init__(self, law: Law, sample_time: float) -> None:
        self._wired, self._law, self._dt = law.wired, law.numbers(), sample_time
        self._memory = np.zeros(self._wired.memory)
        self._samples = 0

    def __call__(self, ref: float, *readings: float) -> tuple[float, ...]:
        self._wired.module.command(
            *(ref, *readings, self._samples * self._dt, self._dt, self._law, self._memory),
            self._wired.design,
        )
        self._samples += 1
        first = core.M_LEFT
        return tuple(self._memory[first : first + len(self._wired.wiring.inputs)].tolist())
