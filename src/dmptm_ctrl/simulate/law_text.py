"""Write the sampled controller of a drive of any shape as source text.

The feed-forward is the balance of torques with all links untwisted: from the ends of the drive to
the body whose speed is controlled, and from there to its motors, who share what that takes.
"""

from itertools import pairwise
from typing import NamedTuple

from dmptm_ctrl.simulate import control_core as core
from dmptm_ctrl.simulate.generate import _Text, head_text
from dmptm_ctrl.simulate.plant import LAW_FIELDS, Structure, number_names


class Wiring(NamedTuple):
    """Which parts of a structure a loop has to do with; coordinates by their numbers."""

    inputs: tuple[int, ...]  # driven
    body: int  # whose speed is controlled
    speed: int | None  # sensor of that speed; None: the difference of the angle
    angle: int | None  # sensor of its angle
    away: tuple[tuple[int, int, int], ...]  # link, coordinate, the next from the body on
    paths: tuple[tuple[int, ...], ...]  # from the body's coordinate to each input's
    sensed: tuple[
        tuple[int, int | None, int], ...
    ]  # coordinate, None and its sensor; link, neighbour

    @property
    def heard(self) -> int:
        """Sensor whose speed is controlled."""
        found = self.angle if self.speed is None else self.speed
        assert found is not None
        return found

    @property
    def sensors(self) -> tuple[int, ...]:
        """Sensors that are read."""
        own = {sensor for _, link, sensor in self.sensed if link is None}
        return tuple(sorted(own | ({self.speed} if self.speed is not None else set())))


def wiring(s: Structure, inputs: tuple[int, ...], sensor: int) -> Wiring:
    """Return the wiring of a loop from a sensor to inputs; ValueError if nothing joins them."""
    body, measures_speed, _ = s.sensors[sensor]
    root = s.bodies[body][0]
    away = _walk(s, [root])
    before = {after: g for _, g, after in away}
    paths = []
    for j in inputs:
        path = [s.bodies[s.inputs[j][0]][0]]
        while path[-1] != root:
            if path[-1] not in before:
                raise ValueError("no link joins the input with the sensor's body")
            path.append(before[path[-1]])
        paths.append(tuple(path[::-1]))
    angles: dict[int, int] = {}  # coordinate -> sensor, one on the body itself first
    positions = [i for i, (_, speed, _) in enumerate(s.sensors) if not speed]
    for i in sorted(positions, key=lambda i: (i != sensor, s.sensors[i][0] != body)):
        g = s.bodies[s.sensors[i][0]][0]
        if g == root or g in before:
            angles.setdefault(g, i)
    own = sorted(angles, key=lambda g: g == root)
    sensed = [(g, None, angles[g]) for g in own] + [(c, k, g) for k, g, c in _walk(s, own)]
    speed = sensor if measures_speed else None
    ends = tuple(away), tuple(paths), tuple(sensed)
    return Wiring(inputs, body, speed, angles.get(root), *ends)


def _walk(s: Structure, starts: list[int]) -> list[tuple[int, int, int]]:
    """Links from coordinate to coordinate, those near the starts first."""
    known, queue = set(starts), list(starts)
    found = []
    while queue:
        g = queue.pop(0)
        for k, (first, second, *_) in enumerate(s.links):
            ends = s.bodies[first][0], s.bodies[second][0]
            other = ends[ends[0] == g]
            if g in ends and other not in known:
                known.add(other)
                queue.append(other)
                found.append((k, g, other))
    return found


def law_text(s: Structure, w: Wiring, flags: int) -> str:
    """Text of the controller: `command`, and `controller` as the compiled loop calls it."""
    drives = [_drive_text(s, j) for j in w.inputs]
    parts = [head_text(s) + _HEAD, *drives, _command_text(s, w), _entry_text(s, w, flags)]
    return "\n\n".join(parts)


_HEAD = """\
from functools import partial

from dmptm_ctrl.simulate import control_core as core
from dmptm_ctrl.simulate.elementary import behind
from dmptm_ctrl.simulate.run import compiled_controller

section, direction_of, signed = (hosted(f) for f in (core.section, core.direction_of, core.signed))
rubbing, built_up = hosted(core.rubbing), hosted(core.built_up)
"""


def _drive_text(s: Structure, j: int) -> str:
    text = _Text(s)
    text.effects(s.at("amplifier", j), "u = {call}", "u", "t")
    return "\n".join([f"@njit\ndef drive_{j}(u, t, on, e):", *text.lines, "    return u"])


def _entry_text(s: Structure, w: Wiring, flags: int) -> str:
    given = ", ".join(f"y[{i}] + noise" if i == w.heard else f"y[{i}]" for i in w.sensors)
    first = core.L_SIZE + len(number_names(s, values=False))
    last = first + flags
    signals = "".join(
        f"    u[{j}] = memory[{core.M_LEFT + side}]\n" for side, j in enumerate(w.inputs)
    )
    return (
        "@partial(compiled_controller, cache=True)\n"
        "def controller(i, t, dt, target, noise, y, rule, memory, u):\n"
        f"    design = {', '.join(f'behind(rule, {n})' for n in (core.L_SIZE, first, last))}\n"
        f"    command(target, {given}, t, dt, rule, memory, design)\n{signals}"
    )


def _command_text(s: Structure, w: Wiring) -> str:
    """Text of one sample of the controller; it leaves the signals in its memory."""
    text = _Text(s)
    text.add("p, on, e = design")
    text.add(*(f"{name} = p[{i}]" for i, name in enumerate(number_names(s, values=False))))
    text.add(*_BEGIN.format(**vars(core)).splitlines())
    _readings(s, w, text)
    text.add(*_FEEDBACK.format(**vars(core)).splitlines())
    text.add("if law[{L_INERTIA}] != 0.0 or law[{L_FRICTION}] != 0.0 or law[{L_EFFECTS}] != 0.0:"
             .format(**vars(core)))  # fmt: skip
    own = _Text(s)
    _forward(s, w, own)
    text.add(*own.lines)
    text.add(*_SIGNALS.format(n=len(w.inputs), **vars(core)).splitlines())
    for side, j in enumerate(w.inputs):
        text.add(*_SIGNAL.format(j=j, side=side, n=len(w.inputs), **vars(core)).splitlines())
    text.add(*_BACK.format(**vars(core)).splitlines())
    arguments = ", ".join(["ref", *(f"y{i}" for i in w.sensors), "t, dt, law, memory, design"])
    return f"@njit\ndef command({arguments}):\n" + "\n".join(text.lines)


_BEGIN = """\
started = memory[{M_STARTED}] > 0.0
rate = (ref - memory[{M_LAST}]) / dt if started else 0.0
rate = max(min(rate, law[{L_ACCELERATION}]), -law[{L_ACCELERATION}])
memory[{M_LAST}], memory[{M_STARTED}] = ref, 1.0
late = ref - law[{L_LATE}] * rate"""
_FEEDBACK = """\
error = late - measured
memory[{M_INTEGRAL}] += error * dt
common = law[{L_KP}] * error + law[{L_KI}] * memory[{M_INTEGRAL}]
common = section(common, {L_SECTIONS}, {M_DELAYS}, law, memory)
common = section(common, {L_SECTIONS} + 5, {M_DELAYS} + 2, law, memory)
memory[{M_LEFT}], memory[{M_RIGHT}] = 0.0, 0.0
speed = ref + law[{L_LEAD}] * rate"""
_SIGNALS = """\
work = abs(common + (memory[{M_LEFT}] + memory[{M_RIGHT}]) / {n}.0)
press = 1.0
if law[{L_RELIEF_TO}] > law[{L_RELIEF_FROM}]:
    press = (law[{L_RELIEF_TO}] - work) / (law[{L_RELIEF_TO}] - law[{L_RELIEF_FROM}])
    press = max(min(press, 1.0), 0.0)
lost = 0.0"""
_SIGNAL = """\
wanted = common + press * law[{L_BIAS_L} + {side}] + memory[{M_LEFT} + {side}]
u = wanted
if law[{L_INVERT}] > 0.0:
    for _ in range({INVERSIONS}):
        u += wanted - drive_{j}(u, t, on, e)
u = max(min(u, law[{L_LIMIT}]), -law[{L_LIMIT}])
memory[{M_LEFT} + {side}] = u
if law[{L_INVERT}] > 0.0:
    u = drive_{j}(u, t, on, e)
lost += (u - wanted) / {n}.0"""
_BACK = """\
if law[{L_KI}] > 0.0:
    memory[{M_INTEGRAL}] += law[{L_TRACKING}] * dt * lost / law[{L_KI}]"""


def _readings(s: Structure, w: Wiring, text: _Text) -> None:
    """Angles and the controlled speed, put right of what their sensors do to them."""
    raw = "0.0" if w.speed is None else f"y{w.speed}"
    text.add(f"measured = {raw}")
    for i in sorted(w.sensors, key=lambda i: i == w.speed):
        b, speed, _ = s.sensors[i]
        both = i != w.speed and not speed
        if both:
            text.add(f"a{i} = y{i}")
        own = f"a{i}" if both else f"a{w.angle}" if w.angle is not None else "0.0"
        rate = "measured" if b == w.body else "0.0"
        if not s.at("sensor", i):
            continue
        text.add(f"for _ in range({core.READINGS}):")
        text.add(f"    a, v = {own}, {rate}")
        inner = _Text(s)
        inner.effects(s.at("sensor", i), "a, v = {call}", "a", "v", "t")
        text.add(*inner.lines)
        text.add(f"    a{i} += y{i} - a" if both else f"    measured += y{i} - v")
    if w.speed is None:
        angle = f"a{w.angle}"
        text.add(f"measured = ({angle} - memory[{core.M_ANGLE}]) / dt if started else 0.0")
        text.add(f"memory[{core.M_ANGLE}] = {angle}")


def _lever(s: Structure, b: int) -> str:
    """Ratio of a body as a factor."""
    return f"r{b}" if s.bodies[b][1] else "1.0"


def _reach(s: Structure, k: int, g: int) -> str:
    """Motion of the coordinate on the other side of a link, per motion of coordinate g."""
    first, second, *_ = s.links[k]
    one, other = _lever(s, first), f"(n{k} * {_lever(s, second)})"
    return f"{one} / {other}" if s.bodies[first][0] == g else f"{other} / {one}"


def _forward(s: Structure, w: Wiring, text: _Text) -> None:
    """Signals that the design model needs to follow the setpoint, into the memory."""
    root = s.bodies[w.body][0]
    text.add(f"reach{root} = 1.0 / {_lever(s, w.body)}")
    for k, g, c in w.away:
        text.add(f"reach{c} = reach{g} * {_reach(s, k, g)}")
    moving = [root, *(c for _, _, c in w.away)]
    for g in moving:
        text.add(f"v{g} = reach{g} * speed")
    sensed = dict.fromkeys(moving, "0.0")
    for g, link, source in w.sensed:
        if link is None:
            sensed[g] = f"a{source} / {_lever(s, s.sensors[source][0])}"
        else:
            sensed[g] = f"measured{source} * {_reach(s, link, source)}"
    for g in [*(g for g, *_ in w.sensed), *(g for g in moving if sensed[g] == "0.0")]:
        text.add(f"measured{g} = {sensed[g]}")
    for g in moving:
        text.add(f"x{g} = measured{g} + law[{core.L_LEAD}] * v{g}")
    text.add(f"way = direction_of(speed, law[{core.L_SOFTNESS}])")
    on_path = {g for path in w.paths for g in path}
    loads: dict[int, list[str]] = {}  # body -> what presses on its bearings
    for side, path in enumerate(w.paths):
        _press(s, w, text, side, path, loads)
    for k, g, c in reversed(w.away):
        if c not in on_path:
            _need(s, w, text, c, loads)
            text.add(f"need_{k} = need{c} * reach{c} / reach{g}")
            _pressed(s, k, g, f"need_{k}", loads)
    _need(s, w, text, root, loads)
    for side, path in enumerate(w.paths):
        text.add(f"share = need{root} / {len(w.paths)}.0")
        for g, c in pairwise(path):
            k = next(k for k, *ends in w.away if ends == [g, c])
            text.add(f"share = share * reach{g} / reach{c}")
            through = f"through_{side}_{c}"
            text.add(f"{through} = share + press_{side} * reach{path[-1]} / reach{c}")
            _pressed(s, k, c, through, loads)
            _need(s, w, text, c, loads)
            text.add(f"share = share + need{c}")
        _volts(s, w, text, side)


def _press(
    s: Structure, w: Wiring, text: _Text, side: int, path: tuple[int, ...], loads: dict
) -> None:
    """Torque of the preload at an input's coordinate, and what it presses on at the other end."""
    j = w.inputs[side]
    biases = [f"law[{core.L_BIAS_L + k}]" for k in range(len(w.inputs))]
    mean = f"({' + '.join(biases)}) / {len(biases)}.0"
    gain = f"{_lever(s, s.inputs[j][0])} * gain{j}"
    text.add(f"press_{side} = {gain} * ({biases[side]} - {mean})")
    if len(path) > 1:
        k = next(k for k, *ends in w.away if ends == [path[0], path[1]])
        _pressed(s, k, path[0], f"press_{side} * reach{path[-1]} / reach{path[0]}", loads)


def _pressed(s: Structure, k: int, g: int, torque: str, loads: dict[int, list[str]]) -> None:
    """Note that a link's torque on coordinate g presses on the bearings of its body there."""
    first, second, _, presses = s.links[k]
    body = first if s.bodies[first][0] == g else second
    if presses:
        loads.setdefault(body, []).append(f"abs(({torque}) / {_lever(s, body)})")


def _need(s: Structure, w: Wiring, text: _Text, g: int, loads: dict[int, list[str]]) -> None:
    """Torque that a coordinate takes along the setpoint, with that of links to ends of the drive.

    Effects at a driven motor are not in it; they take the signal.
    """
    text.add(f"rub{g}, slow{g} = 0.0, 0.0")
    for b in s.body_names(g):
        _rub(s, text, g, b, " + ".join(loads.get(b, ["0.0"])))
    bristle = next((b for b in s.bristles if b in s.body_names(g)), None)
    if bristle is not None and _rubs(s, bristle):
        row = f"bd{bristle} / abs({_lever(s, bristle)}), bs{bristle}, law_{bristle}"
        place = core.M_BRISTLES + g
        text.add(f"rub{g} = built_up(rub{g}, slow{g}, v{g}, dt, {row}, {place}, memory)")
    text.add(
        f"need{g} = law[{core.L_INERTIA}] * (reach{g} * rate) / m{g} "
        f"+ law[{core.L_FRICTION}] * rub{g}"
    )
    driven = [s.inputs[j][0] for j in w.inputs]
    for b in s.body_names(g):
        motion = text.turned(b, "x"), text.turned(b, "v")
        change = f"need{g} = need{g} - law[{core.L_EFFECTS}] * {_lever(s, b)} * {{call}}"
        text.effects(s.at("load", b), change, *motion, "t")
        if b not in driven:
            text.effects(s.at("motor", b), change, "0.0", *motion, "t")
    for k, one, other in w.away:
        if one == g and all(other not in path for path in w.paths):
            text.add(f"need{g} = need{g} + need_{k}")


def _rubs(s: Structure, b: int) -> bool:
    return bool(s.bodies[b][2] or s.at("friction", b))


def _rub(s: Structure, text: _Text, g: int, b: int, load: str) -> None:
    """Add the friction of a body."""
    if not _rubs(s, b):
        return
    law, places = s.bodies[b][2], s.at("friction", b)
    fields = [f"w{b}_{field}" for field in LAW_FIELDS] if law else ["0.0"] * 8 + ["1.0"] * 3
    lever = _lever(s, b)
    text.add(
        f"law_{b} = Stribeck({', '.join(fields)})",
        f"way_{b} = signed(way, reach{g} * {lever})",
        f"omega_{b} = {lever} * v{g}",
        f"load_{b} = {load}",
        f"scale_{b}, added_{b} = 1.0, 0.0",
    )
    change = f"c = {{call}}; scale_{b} = scale_{b} * c[0]; added_{b} = added_{b} + c[1]"
    text.effects(places, change, text.turned(b, "x"), f"omega_{b}", "t", f"load_{b}")
    text.add(
        f"c = rubbing(omega_{b}, way_{b}, scale_{b}, added_{b}, law_{b})",
        f"rub{g} = rub{g} + {lever} * c[0]",
        f"slow{g} = slow{g} + {lever} * c[1]",
    )


def _volts(s: Structure, w: Wiring, text: _Text, side: int) -> None:
    """Signal of an input that gives its share, and what effects at the motor take."""
    j = w.inputs[side]
    b = s.inputs[j][0]
    lever = _lever(s, b)
    text.add(f"drive = share / ({lever} * gain{j})")
    motion = text.turned(b, "x"), text.turned(b, "v")
    change = f"share = share - law[{core.L_EFFECTS}] * {lever} * {{call}}"
    text.effects(s.at("motor", b), change, "drive", *motion, "t")
    text.add(f"memory[{core.M_LEFT + side}] = share / ({lever} * gain{j})")
