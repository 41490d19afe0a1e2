"""A designed controller: as gains, python-control systems, difference equations and a file."""

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import control as ct
import tomlkit

from dmptm_ctrl.arguments import refusing
from dmptm_ctrl.control.pi import pi_controller, sampled_pi
from dmptm_ctrl.control.sections import in_series, notch, sampled_notch
from dmptm_ctrl.design.draws import slow_friction
from dmptm_ctrl.drive.parameters import physical
from dmptm_ctrl.drive.rig_units import input_symbol
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.atomic import write_atomic
from dmptm_ctrl.signals.numbers import finite_numbers
from dmptm_ctrl.signals.toml_text import read_toml
from dmptm_ctrl.simulate.any_model import default_loop
from dmptm_ctrl.simulate.law import Design, Law
from dmptm_ctrl.simulate.model_file import begun, model_of, model_text, with_unit
from dmptm_ctrl.simulate.rig_model import RigModel

KIND = "speed controller"
SCHEMA = 1
# number of a controller -> unit, as in its file; V and rad stand for those of a rig's parts
UNITS = {
    "kp": "V/(rad/s)",
    "ki": "V/rad",
    "limit": "V",
    "preload": "V, added on the left motor and taken off on the right",
    "sample_time": "s",
    "tracking": "1/s",
    "inertia": "1",
    "friction": "1",
    "effects": "1",
    "lead": "s",
    "late": "s",
    "acceleration": "rad/s^2",
    "softness": "rad/s",
    "distance": "rad",
    "relief_from": "V",
    "relief_to": "V",
}


@dataclass(frozen=True)
class Notch:
    """A second-order section; see :func:`~dmptm_ctrl.control.sections.notch`."""

    hz: float
    depth: float
    width: float


@refusing
@dataclass(frozen=True)
class Controller(Design):
    """PI on the speed of a ring gear, or of a rig's sensor, with what a model lets one add.

    Units are those of the dual-motor drive. Of a rig V stands for the SI unit of the input, and
    rad for that of the sensor's angle or position.

    Attributes
    ----------
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    limit : float [V]
        Clip of each motor's voltage.
    preload : float [V]
        Added on the left motor, taken off on the right. 0 for a rig.
    sample_time : float [s]
    tracking : float [1/s]
        Rate at which the integral gives back what the limit cuts off; 0 is none.
    inertia, friction, effects : float
        Shares of the model's torques that are fed forward along the setpoint; 1 is all.
    lead, late : float [s]
        How far the feed-forward looks ahead; how late the speed is read.
    acceleration : float [rad/s²]
        Largest of the setpoint that is fed forward.
    softness : float [rad/s]
        Setpoint below which the friction fed forward fades to 0.
    invert : bool
        Whether offset, dead band and gain errors of the amplifiers are undone.
    model : Model or RigModel
        What is fed forward, and undone.
    input, sensor : str
        Of a rig: the motor, and the sensor whose speed is controlled.
    notches : tuple of Notch
        Up to two in the simulated loop; any number in the equations and transfer functions.
    distance : float [rad]
        Over which the friction fed forward builds up beyond what `model` says, at the ring gear.
    relief_from, relief_to : float [V]
        Common voltages between which the preload fades to nothing, as in torque-bias profiles
        of antennas (Gawronski et al. 2000, ref. 15 of the paper); equal ones keep it constant.

    Examples
    --------
    >>> controller = dm.Controller(5.0, 90.0, limit=10.0, preload=0.3)
    >>> controller.to_ss().output_labels
    ['u']
    """

    preload: float = 0.0
    sample_time: float = 1e-3
    _: KW_ONLY
    tracking: float = 10.0
    notches: tuple[Notch, ...] = ()
    distance: float = 0.0
    relief_from: float = 0.0
    relief_to: float = 0.0

    def __post_init__(self) -> None:
        physical("sample_time of the controller", self.sample_time, "s")
        if self.preload and isinstance(self.model, RigModel):
            raise ValueError("a preload needs two motors; the controller of a rig has one")

    @property
    def units(self) -> tuple[str, str]:
        """SI units of the input and of the sensor's angle or position."""
        if not isinstance(self.model, RigModel):
            return "V", "rad"
        source, sensor = default_loop(self.model.rig, self.input, self.sensor)
        body = next(s.body for s in self.model.rig.sensors if s.name == sensor)
        return input_symbol(self.model.rig, source), self.model.rig.body(body).angle_unit

    def law(self) -> Law:
        """Return it as the compiled simulator takes it."""
        model, dt = self.model, self.sample_time
        if self.distance > 0.0:
            model = slow_friction(model, self.distance)
        return Law(
            **{**self.shared(), "model": model},
            bias_l=self.preload,
            bias_r=-self.preload,
            sections=[sampled_notch(n.hz, n.depth, n.width, dt) for n in self.notches],
            relief=(self.relief_from, self.relief_to),
        )

    def to_ss(self) -> ct.StateSpace:
        """Return the feedback part, continuous: from ``error`` [rad/s] to ``u`` [V]."""
        sys = pi_controller(self.kp, self.ki)
        for part in self.notches:
            sys = ct.ss(notch(part.hz, part.depth, part.width)) * sys
        return ct.ss(sys.A, sys.B, sys.C, sys.D, inputs=["error"], outputs=["u"], name="feedback")

    def to_discrete(self) -> ct.StateSpace:
        """Return the feedback part as it runs, in z at the sample time: ``error`` to ``u``."""
        dt = self.sample_time
        parts = [sampled_notch(n.hz, n.depth, n.width, dt) for n in self.notches]
        sys = in_series(sampled_pi(self.kp, self.ki, dt), parts, dt)
        return ct.ss(sys, inputs=["error"], outputs=["u"], name="feedback")

    def equations(self) -> str:
        """Return the difference equations of one sample k as text, with their numbers.

        All but the line of the feed-forward can be run as they stand: ``x[k]`` is the value of
        this sample, ``x[k-1]`` that of the last one, 0 before the first;
        ``clip(x, low, high)`` limits. Numbers have all their digits, so the feedback is that of
        :meth:`to_discrete`.
        """
        dt, limit = _full(self.sample_time), _full(self.limit)
        top = _full(self.acceleration)
        sides, measured = [("_left", " +"), ("_right", " -")], "omega_L"
        if isinstance(self.model, RigModel):
            sides, measured = [("", "")], "speed"
        lines = [
            f"every {dt} s:",
            f"a[k] = clip((ref[k] - ref[k-1])/{dt}, -{top}, {top})",
            f"e[k] = ref[k] - {_full(self.late)}*a[k] - {measured}[k]",
            f"I[k] = I[k-1] + {dt}*e[k]",
            f"v[k] = {_full(self.kp)}*e[k] + {_full(self.ki)}*I[k]",
        ]
        last = "v"
        for i, part in enumerate(self.notches, 1):
            row = sampled_notch(part.hz, part.depth, part.width, self.sample_time)
            b0, b1, b2, a1, a2 = (_full(x) for x in row)
            new = "w" if i == len(self.notches) else f"w{i}"
            lines.append(
                f"{new}[k] = {b0}*{last}[k] + {b1}*{last}[k-1] + {b2}*{last}[k-2] "
                f"- {a1}*{new}[k-1] - {a2}*{new}[k-2]"
            )
            last = new
        which = ", s = left, right" if len(sides) > 1 else ""
        lines.append(
            f"f{'_s' * bool(which)}[k] = signal of the model at speed ref[k] + "
            f"{_full(self.lead)}*a[k]{which}: {self.inertia:g} × inertia + {self.friction:g} × "
            f"friction - {self.effects:g} × torques of motor and load effects"
        )
        press = _full(self.preload)
        if self.relief_to > self.relief_from:
            span = _full(self.relief_to - self.relief_from)
            lines.append(
                f"p[k] = {press}*clip(({_full(self.relief_to)} - "
                f"abs({last}[k] + 0.5*(f_left[k] + f_right[k])))/{span}, 0.0, 1.0)"
            )
            press = "p[k]"
        for side, sign in sides:
            own = f"inverse of the drive of wanted{side}[k]" if self.invert else f"wanted{side}[k]"
            pressed = f"{sign} {press}" if sign else ""
            lines += [
                f"wanted{side}[k] = {last}[k]{pressed} + f{side}[k]",
                f"u{side}[k] = clip({own}, -{limit}, {limit})",
            ]
        if self.tracking > 0.0 and self.ki > 0.0:
            back = _full(self.tracking * self.sample_time / self.ki / len(sides))
            got = "drive of u{0}[k]" if self.invert else "u{0}[k]"
            lost = " + ".join(f"{got} - wanted{{0}}[k]".format(s) for s, _ in sides)
            lines.append(f"I[k] = I[k] + {back}*({lost})")
        return "\n".join(lines)

    def to_toml(self) -> str:
        """Return the text of a controller file: numbers, notches, difference equation, model."""
        document = begun("Speed controller", KIND, SCHEMA)
        for line in self.equations().splitlines():
            document.add(tomlkit.comment(line))
        table = tomlkit.table()
        volt, rad = self.units
        for name, unit in UNITS.items():
            own = unit.replace("rad", rad).replace("V", volt)
            table[name] = with_unit(getattr(self, name), own)
        table["invert"] = self.invert
        table["input"], table["sensor"] = self.input, self.sensor
        document["controller"] = table
        notches = tomlkit.aot()
        for part in self.notches:
            row = tomlkit.table()
            b0, b1, b2, a1, a2 = sampled_notch(part.hz, part.depth, part.width, self.sample_time)
            row.update({"hz": part.hz, "depth": part.depth, "width": part.width})
            row.update({"b": [b0, b1, b2], "a": [1.0, a1, a2]})
            notches.append(row)
        if self.notches:
            document["notch"] = notches
        document["model"] = tomlkit.string(model_text(self.model), multiline=True)
        return tomlkit.dumps(document)

    def save(self, file: str | PathLike[str]) -> None:
        """Write the controller file, whole or not at all."""
        write_atomic(Path(file), self.to_toml())


def _full(value: float) -> str:
    """Shortest text that reads back as the same number, in brackets where it is negative."""
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def read_controller(file: str | PathLike[str]) -> Controller:
    """Read a controller file.

    Parameters
    ----------
    file : path

    Returns
    -------
    Controller

    Raises
    ------
    LogError
        No such file, not TOML, another kind, a number that is missing or not finite.

    Examples
    --------
    >>> dm.read_controller("controller.toml").kp
    5.0
    """
    path = Path(file)
    _, data = read_toml(path, "controller")
    if data.get("kind") != KIND or data.get("schema") != SCHEMA:
        raise LogError(f'{path.name}: needs kind = "{KIND}" and schema = {SCHEMA}')
    table = data.get("controller", {})

    def numbers(given: dict[str, Any], names: Iterable[str], where: str) -> dict[str, float]:
        return finite_numbers(path.name, where, {name: given.get(name) for name in names})

    found = numbers(table, UNITS, "controller")
    rows = data.get("notch", [])
    notches = tuple(Notch(**numbers(r, ("hz", "depth", "width"), "notch")) for r in rows)
    model = model_of(str(data.get("model", "")), f"{path.name}, [model]")
    names = {name: str(table.get(name, "")) for name in ("input", "sensor")}
    invert = bool(table.get("invert", False))
    try:
        rest: dict[str, Any] = {**found, **names}
        return Controller(**rest, notches=notches, invert=invert, model=model)
    except ValueError as error:
        raise LogError(f"{path.name}: {error}") from None
