"""A rig as data: bodies, what joins them, what drives them, what is measured.

Made from a file by :func:`dmptm_ctrl.drive.rigfile.load_rig`.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from math import inf, isfinite, nan, pi
from pathlib import Path
from typing import Any, TypeGuard

from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.signals import Column, Log, LogError, TextFormat, load_log
from dmptm_ctrl.signals.columns import listed
from dmptm_ctrl.signals.errors import repeated
from dmptm_ctrl.signals.loaders import gather, stem

SMALL = 0.1  # of a time constant; a lag beside it that is shorter moves poles by as little
LONG_LEAD = 1.0  # m per turn; a pulley has a third of a metre across then
DEFAULT_TOLERANCE = 0.3  # of a declared value that does not state one; documented in rig_toml.md

FRICTION = (  # names per direction; without _plus, _minus the same in both
    *("static_plus", "coulomb_plus", "stribeck_speed_plus", "viscous_plus"),
    *("static_minus", "coulomb_minus", "stribeck_speed_minus", "viscous_minus"),
)


def unknown(unit: str) -> Quantity:
    """A positive quantity of which nothing is declared."""
    return Quantity(nan, unit, 0.0, "unknown", low=0.0, high=inf)


def is_known(quantity: Quantity | None) -> TypeGuard[Quantity]:
    """Whether a value is declared."""
    return quantity is not None and isfinite(quantity.value)


DECLARES = {  # effect: keys of a body's friction, any of which declares it
    "viscous_friction": ("viscous", "viscous_plus"),
    "coulomb_friction": ("coulomb", "coulomb_plus"),
    "stribeck_friction": ("static", "static_plus"),
    "friction_asymmetry": ("coulomb_plus", "viscous_plus"),
}


@dataclass(frozen=True)
class Body:
    """A rigid body with one coordinate, an angle [rad] or a position [m]."""

    name: str
    inertia: Quantity  # kg·m² of a rotary body, kg of a linear one
    linear: bool = False
    # static, coulomb, stribeck_speed, viscous, each for both directions or as _plus and _minus, and
    # stribeck_exponent; magnitudes; what is not there is not declared
    friction: Mapping[str, Quantity] = field(default_factory=dict)

    def __str__(self) -> str:
        friction = ", ".join(f"{key} {value}" for key, value in self.friction.items())
        kind = "mass" if self.linear else "inertia"
        return f"{kind} {self.inertia}" + (f"; friction: {friction}" if friction else "")

    @property
    def angle_unit(self) -> str:
        """SI unit of the coordinate."""
        return "m" if self.linear else "rad"

    @property
    def force_unit(self) -> str:
        """SI unit of what accelerates it."""
        return "N" if self.linear else "N·m"


CONTACTS = ("eq21", "two_state", "impact")  # paper Eq. 21, its original, Hunt and Crossley


@dataclass(frozen=True)
class Link:
    """A shaft or mesh between two bodies: twist z = q_first − ratio · q_second."""

    name: str
    first: str
    second: str
    ratio: Quantity
    stiffness: Quantity | None = None  # at the first body; None is rigid
    damping: Quantity | None = None
    half_gap: Quantity | None = None  # of the backlash, at the first body; None: without gap
    gap_damping: Quantity | None = None
    mesh: bool = False
    # Law of a link with a gap, of :data:`CONTACTS`. With "impact" the damping is that of Hunt and
    # Crossley, in s per unit of depth.
    contact: str = "eq21"

    def __str__(self) -> str:
        parts = [f"{'mesh' if self.mesh else 'shaft'} {self.name}"]
        if self.ratio.value != 1:
            unit = f" {self.ratio.unit}" if self.ratio.unit else ""
            parts.append(f"ratio {self.ratio.value:.6g}{unit} ({self.first} per {self.second})")
        parts.append("rigid" if self.rigid else f"stiffness {self.stiffness}")
        if self.damping is not None:
            parts.append(f"damping {self.damping}")
        if self.half_gap is not None:
            parts.append(f"half-gap {self.half_gap}")
        return ", ".join(parts)

    @property
    def rigid(self) -> bool:
        """Whether it is declared without compliance."""
        return self.stiffness is None


@dataclass(frozen=True)
class Input:
    """A motor or force on one body; torque = gain · signal."""

    name: str
    column: str  # in the logs
    unit: str  # of the column
    body: str
    # torque or force per SI unit of the signal; unknown: counted in the signal's unit
    gain: Quantity
    sign: float = 1.0  # factor on the column, as −1 where it counts the other way
    back_emf: float = 0.0  # N·m·s/rad that a voltage-driven motor adds to viscous friction, k²/R
    delay: Quantity | None = None  # dead time [s]
    time_constant: Quantity | None = None  # of a first-order lag [s]
    limit: Quantity | None = None
    # what the gain is the product of (amplifier, torque_constant, …)
    factors: Mapping[str, Quantity] = field(default_factory=dict)

    @property
    def channel(self) -> str:
        """Name of its signal in a loaded log."""
        return f"in_{self.name}"


@dataclass(frozen=True)
class Sensor:
    """A measured position or speed of one body."""

    name: str
    column: str
    unit: str
    body: str
    measures: str  # "position" or "speed"
    sign: float = 1.0
    resolution: Quantity | None = None  # step of the reading, SI
    noise: Quantity | None = None  # rms, SI
    absolute: bool = False  # zero is the same in every log; an incremental encoder's is not

    @property
    def channel(self) -> str:
        """Name of its signal in a loaded log."""
        return f"out_{self.name}"


@dataclass(frozen=True)
class Controller:
    """The loop that ran while the logs were taken, sampled at the logs' rate."""

    # "pi_speed": u = kp e + ki ∫e of the speed; "cascade": u = kp kv (r − q) − kv ω
    kind: str
    input: str
    sensor: str
    gains: Mapping[str, float]  # kp, ki, kv in SI
    reference: str  # column of the set point
    reference_unit: str
    limit: float = inf


@dataclass(frozen=True)
class DeclaredEffect:
    """An effect that the declaration already contains."""

    name: str
    on: str  # body, link, input or sensor; "": its only place, or the first body
    values: Mapping[str, Quantity]


def _fits(name: str, pattern: str) -> bool:
    """Whether a pattern means a log, by its name or that of its file, "run_a" or "run_a.csv"."""
    return fnmatchcase(name, pattern) or fnmatchcase(name, stem(pattern))


def _ignored(file: str, pattern: str) -> bool:
    """Whether a pattern leaves out a file: it keeps its extension where it has one."""
    return any(fnmatchcase(name, pattern) for name in (file, stem(file)))


def _of_log(values: Mapping[str, float], name: str) -> float | None:
    """Value of a log by its name, else by the first pattern that fits."""
    fitting = (v for pattern, v in values.items() if _fits(name, pattern))
    return values.get(name, next(fitting, None))


@dataclass(frozen=True)
class DataSpec:
    """How logs come in."""

    # column and unit; None: ``time_s``; without a unit that of the file, else seconds
    time: tuple[str, str] | None = None
    sample_time: float | None = None  # of logs without a time column [s]
    fit: tuple[str, ...] = ()  # patterns of log names; empty leaves the choice to the diagnosis
    held_out: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)  # by pattern: part that is used [s]
    stop: Mapping[str, float] = field(default_factory=dict)
    text: TextFormat = field(default_factory=TextFormat)  # layout of text files

    def window(self, name: str) -> tuple[float | None, float | None]:
        """Part of a log that is used [s], from its first sample; None: its end."""
        return _of_log(self.start, name), _of_log(self.stop, name)


@dataclass(frozen=True, repr=False)
class Rig:
    """A declared drive of any shape; ``print(rig)`` draws it as a tree of text.

    Attributes
    ----------
    bodies, links, inputs, sensors : tuples
        In the order of the file.
    ties : mapping
        Keys of quantities that are another's, as ``body.right.inertia`` → ``body.left.inertia``.

    Examples
    --------
    >>> rig = dm.load_rig("rig.toml")  # ``dmptm rig init`` writes one to start from
    >>> [body.name for body in rig.bodies]
    ['motor_left', 'motor_right', 'pinion_left', 'pinion_right', 'ring_gear']
    """

    name: str
    bodies: tuple[Body, ...]
    links: tuple[Link, ...]
    inputs: tuple[Input, ...]
    sensors: tuple[Sensor, ...]
    effects: tuple[DeclaredEffect, ...] = ()
    controller: Controller | None = None
    data: DataSpec = field(default_factory=DataSpec)
    source: str = ""
    text: str = ""
    ties: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        parts = (f"{len(getattr(self, k))} {k}" for k in ("bodies", "links", "inputs", "sensors"))
        return f"<Rig {self.name!r}: {', '.join(parts)}>"

    def __str__(self) -> str:
        lines = [self.name]
        for depth, link, body in self.walk():
            stem = "    " * depth
            if link is not None:
                lines.append(f"{stem[4:]}└── {link}")
            lines.append(f"{stem}[{body.name}] {body}")
            for source in (i for i in self.inputs if i.body == body.name):
                gain = source.gain
                lines.append(f"{stem}  ← {source.name}: column {source.column}, gain {gain}")
            for sensor in (s for s in self.sensors if s.body == body.name):
                lines.append(f"{stem}  → {sensor.name}: {sensor.measures}, column {sensor.column}")
        lines += [f"declared effect: {e.name}{e.on and f' on {e.on}'}" for e in self.effects]
        if self.controller is not None:
            loop = self.controller
            lines.append(f"controller: {loop.kind} from {loop.sensor} to {loop.input}")
        return "\n".join(lines)

    def alike(self, place: str) -> tuple[str, ...]:
        """Return places of one make with a body, link or input, itself included.

        As ``like`` in a rig file says of bodies and links; inputs are alike if their gains and the
        bodies that they drive are.
        """
        source = next((i for i in self.inputs if i.name == place), None)
        if source is not None:
            bodies = self.alike(source.body)
            return tuple(
                i.name for i in self.inputs
                if i.body in bodies and (i.gain, i.factors) == (source.gain, source.factors)
            )  # fmt: skip
        first = {k.split(".")[1]: v.split(".")[1] for k, v in self.ties.items()}
        names = (*(b.name for b in self.bodies), *(k.name for k in self.links))
        make = first.get(place, place)
        return tuple(n for n in names if first.get(n, n) == make)

    def walk(self) -> Iterator[tuple[int, Link | None, Body]]:
        """Bodies from the first driven one outwards, with the link that leads to each."""
        done = set()
        waiting: list[tuple[int, Link | None, str]] = [(0, None, self.inputs[0].body)]
        while waiting:
            depth, link, name = waiting.pop()
            done.add(name)
            yield depth, link, self.body(name)
            for k in reversed(self.links):
                if name in (k.first, k.second):
                    other = k.second if k.first == name else k.first
                    if other not in done:
                        waiting.append((depth + 1, k, other))

    @property
    def speed_sensor(self) -> Sensor:
        """The first sensor of speed, else the first of all."""
        return next((s for s in self.sensors if s.measures == "speed"), self.sensors[0])

    def body(self, name: str) -> Body:
        """Body by name."""
        return next(b for b in self.bodies if b.name == name)

    def link(self, name: str) -> Link:
        """Shaft or mesh by name."""
        return next(link for link in self.links if link.name == name)

    def turns(self, body: str, *, rigidly: bool = False) -> dict[str, float]:
        """Turns of each body per turn of one, through links of known ratio, all or rigid ones."""
        turns = {body: 1.0}
        for _ in self.links:
            for link in self.links:
                if not is_known(link.ratio) or (rigidly and not link.rigid):
                    continue
                if link.first in turns:  # q_first = ratio · q_second
                    turns.setdefault(link.second, turns[link.first] / link.ratio.value)
                elif link.second in turns:
                    turns[link.first] = turns[link.second] * link.ratio.value
        return turns

    def cautions(self) -> list[str]:
        """Sentences about what models leave out although it may matter, and about long leads."""
        found = []
        for link in self.links:
            slides = self.body(link.second).linear and not self.body(link.first).linear
            if slides and (lead := 2 * pi / abs(link.ratio.value)) >= LONG_LEAD:
                found.append(
                    f"{link.name} moves {link.second} by {lead:.4g} m per turn of {link.first} (a "
                    "lead without a unit is in metres); if millimetres are meant, write "
                    f"lead = '{lead:.4g} mm'"
                )
        for source in (i for i in self.inputs if i.back_emf and "inductance" in i.factors):
            electric = source.factors["inductance"].value / source.factors["resistance"].value
            turns = self.turns(source.body, rigidly=True)
            inertia = sum(t**2 * self.body(name).inertia.value for name, t in turns.items())
            mechanic = inertia / source.back_emf
            if electric > SMALL * mechanic:
                found.append(
                    f"input {source.name}: its inductance delays the voltage, but not the "
                    f"back-EMF; L/R of {electric:.3g} s is not small beside J R/(K_t K_e) of "
                    f"{mechanic:.3g} s, and fast motion comes out wrong"
                )
        return found

    def columns(self) -> dict[str, Column]:
        """Columns of the logs that the rig needs, as the loaders take them."""
        mapping: dict[str, Column] = {}
        if self.data.time is not None:
            column, unit = self.data.time
            mapping[column] = Column("time", unit)
        items: tuple[Input | Sensor, ...] = (*self.inputs, *self.sensors)
        for item in items:
            mapping[item.column] = Column(item.channel, item.unit, item.sign)
        if self.controller is not None:
            mapping[self.controller.reference] = Column("reference", self.controller.reference_unit)
        return mapping

    def labels(self) -> dict[str, tuple[str, str]]:
        """Column and unit of each channel, by the channel's name."""
        return {c.channel: (name, c.unit) for name, c in self.columns().items()}

    def declared_names(self) -> set[str]:
        """Names of effects that every body or link of the rig declares already."""
        names = {e.name for e in self.effects}
        for effect, keys in DECLARES.items():
            if all(any(k in b.friction for k in keys) for b in self.bodies):
                names.add(effect)
        if self.links and all(not k.rigid for k in self.links):
            names.add("shaft_compliance")
        if self.links and all(k.half_gap is not None for k in self.links):
            names.add("backlash")
        return names

    def read(
        self,
        sources: Any,
        *,
        columns: Mapping[str, Column] | None = None,
        max_rows: int | None = None,
        notes: list[str] | None = None,
    ) -> tuple[Log, ...]:
        """Load logs of this rig: channels ``in_NAME`` and ``out_NAME``, SI, in order of names.

        `sources` are paths, DataFrames or Logs. A folder stands for all logs in it, but those
        under ``[data] ignore``; files that are no logs are left out, and `notes` gets a sentence
        about each. Logs that have the rig's channels already are taken as they are; of others
        `columns` become channels, by default the rig's own. Rows of a file after `max_rows` are
        not read, with a warning. LogError as of `load_log`, and for no
        log, or two of one name.
        """
        seen: list[Path] = []

        def ignored(path: Path) -> bool:
            seen.append(path)
            return any(_ignored(path.name, p) for p in self.data.ignore)

        loaded, left_out = gather(
            sources, lambda s, **o: self.load(s, columns, max_rows=max_rows, **o), ignored
        )
        if notes is not None:
            notes += [
                *left_out,
                *self.cautions(),
                *self._without_match([log.name for log in loaded], seen),
            ]
        if not loaded:
            raise LogError("no logs: every file is under [data] ignore of the rig file")
        if (twice := repeated(log.name for log in loaded)) is not None:
            raise LogError(f"two logs are named {twice}; rename one")
        return tuple(sorted(loaded, key=lambda log: log.name))

    def load(self, source: Any, columns: Mapping[str, Column] | None = None, **options: Any) -> Log:
        """Load one log as ``[data]`` says, as `load_log`; by default the rig's own channels."""
        if isinstance(source, Log):
            return self._checked(source)
        columns = self.columns() if columns is None else columns
        name = options.get("name") or stem(Path(source).name)
        return load_log(
            source, columns, sample_time=self.data.sample_time, window=self.data.window(name),
            how=self.data.text, **options,
        )  # fmt: skip

    def read_inputs(self, source: Any) -> Log:
        """Load one log for a prediction, as `load_log`: the sensors' columns may be missing."""
        try:
            return self.load(source)
        except LogError:
            own = {"time", *(i.channel for i in self.inputs)}
            return self.load(source, {k: c for k, c in self.columns().items() if c.channel in own})

    def _checked(self, log: Log) -> Log:
        for channel in self.labels():
            if channel != "time" and channel not in log:
                raise LogError(f"{log.name}: no channel {channel!r} of rig {self.name!r}")
        start, stop = self.data.window(log.name)
        if start is None and stop is None:
            return log
        low = float(log.time[0])
        high = float(log.time[-1]) if stop is None else low + stop
        return log.segment(low + (start or 0.0), high)

    def _without_match(self, names: list[str], files: list[Path]) -> list[str]:
        """Sentences about patterns of ``[data]`` that mean no log."""
        tried = self.data.ignore if files else ()
        lost = [("ignore", p) for p in tried if not any(_ignored(f.name, p) for f in files)]
        for key in ("fit", "held_out", "start", "stop"):
            patterns = getattr(self.data, key)
            lost += [(key, p) for p in patterns if not any(_fits(n, p) for n in names)]
        there = listed(sorted(names), 4)
        return [f"[data] {k} names {p!r}, which fits no log; there are {there}" for k, p in lost]

    def roles(self, names: Iterable[str]) -> dict[str, str]:
        """Role that the file declares for logs: "fit", "held-out" or "" (no word)."""
        found = {}
        for name in names:
            fit = any(_fits(name, p) for p in self.data.fit)
            held = any(_fits(name, p) for p in self.data.held_out)
            found[name] = "held-out" if held else "fit" if fit else ""
        return found
