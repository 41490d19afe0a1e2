"""The loop over samples of one drive around its step, as source text."""

from dmptm_ctrl.simulate.generate import (
    Engine,
    Names,
    compiled,
    engine_by,
    head_text,
    observe_text,
    sensed,
    step_text,
)
from dmptm_ctrl.simulate.plant import Structure


def product(s: Structure, i: int) -> str:
    """Text of what a sensor sees."""
    return " * ".join(filter(None, sensed(s, i)))


def scalar_text(s: Structure) -> str:
    """Text of the loop over samples of one drive; see `run.march` for its arguments."""
    names = Names(s)
    state = ", ".join(names.state)
    inputs, links, g_all = len(s.inputs), len(s.links), range(s.coordinates)
    late = [i for i, sensor in enumerate(s.sensors) if sensor[2]]
    # as tuples: one by one, or as a slice with its error's message, they are long to compile
    rows = f"    {', '.join(names.numbers)}, = spread(p, {len(names.numbers)})\n"
    rows += f"    {state}, = spread(x, {len(names.state)})\n"
    store = f"    gather(x, ({state},))\n"
    sensors = len(s.sensors)
    lags = "".join(
        f"        late{i} = read_late(ring, {n}, step0 + done, delays[{n}] / h)"
        + (f" if delays[{n}] > 0.0 else {product(s, i)}\n" if s.either else "\n")
        for n, i in enumerate(late)
    )
    plain = [*names.state, "t", *names.numbers, *names.switches]
    observed = ", ".join([*names.state, *(f"late{i}" for i in late), *plain[len(names.state) :]])
    out = "".join(f"        out[i, {c}] = seen[{c}]\n" for c in range(sensors))
    if links:
        out += f"        if out.shape[1] > {sensors}:\n"
        out += f"            seen_ = torques({', '.join(plain)})\n"
        out += "".join(
            f"            out[i, {sensors + c}] = seen_[{c}]\n" for c in range(2 * links)
        )
    first_q = sensors + 2 * links
    out += f"        if out.shape[1] > {first_q}:\n"
    for c in g_all:
        out += f"            out[i, {first_q + c}] = q{c}\n"
        out += f"            out[i, {first_q + s.coordinates + c}] = v{c}\n"
    y = "".join(f"            y[{i}] = seen[{i}]\n" for i in range(sensors))
    given, set_given = "", ""
    for n, g in enumerate(g_all if s.either else s.given):
        if s.either:
            given += f"            xg{g}, sg{g} = 0.0, 0.0\n            if is{g} > 0.0:\n"
            set_given += f"        if is{g} > 0.0:\n"
        for x, table in (("x", "given_q"), ("s", "given_v")):
            now = f"{table}[{n}, i]"
            given += f"{'    ' * (3 + s.either)}{x}g{g} = "
            given += f"{now} + part * ({table}[{n}, after] - {now})\n"
        set_given += f"{'    ' * (2 + s.either)}q{g}, v{g} = given_q[{n}, i], given_v[{n}, i]\n"
    signals = "".join(
        f"            u{j} = u[{j}, at] if dead[{j}] <= 0.0 else held_average(u, {j}, "
        f"at + k / substeps - dead[{j}], at + (k + 1) / substeps - dead[{j}], before)\n"
        for j in range(inputs)
    )
    push = "".join(f"        push{g} = push[i, {g}] if pushed else 0.0\n" for g in g_all)
    ring = "".join(
        (f"            if delays[{n}] > 0.0:\n    " if s.either else "")
        + f"            ring[{n}, (step0 + done) % ring.shape[1]] = {product(s, i)}\n"
        for n, i in enumerate(late)
    )
    read = "".join(f"            read[{i}, 0] = seen[{i}]\n" for i in range(sensors))
    led = "".join(
        f"            q{g} += moves[{g}, 0]\n"
        f"            kick = moves[{s.coordinates + g}, 0] if v{g} != 0.0 else 0.0\n"
        f"            v{g}, p{g} = v{g} + kick, p{g} + kick\n"
        for g in g_all
    )
    for n, i in enumerate(late):
        if not s.sensors[i][1]:
            ratio, name = sensed(s, i)
            # not as one row: its error's message would be long to compile
            led += "            for back in range(ring.shape[1]):\n"
            led += f"                ring[{n}, back] += {ratio or 1.0} * moves[{name[1:]}, 0]\n"
    led += "".join(f"            out[i, {i}] = read[{i}, 0]\n" for i in range(sensors))
    return f"""\
@njit
def march(
    x, p, on, e, acts, sites, posts, r,
    u, first, before, dead, push, given_q, given_v, ring, delays, step0, begin,
    dt, substeps, control, rule, memory, target, noise, closed, y, command,
    read, watched, measured, gains, shown, leak, lead, moves, out,
):
    acts, sites, posts = borrowed(acts), borrowed(sites), borrowed(posts)
    on, e, r = borrowed(on), borrowed(e), borrowed(r)
    y, command = borrowed(y), borrowed(command)
    rule, memory, read, moves = borrowed(rule), borrowed(memory), borrowed(read), borrowed(moves)
    watched, measured, gains = borrowed(watched), borrowed(measured), borrowed(gains)
    shown, leak, lead = borrowed(shown), borrowed(leak), borrowed(lead)
    h = dt / substeps
{rows}
    pushed = push.shape[0] > 0
    done = 0
    for i in range(out.shape[0]):
        t = begin + i * dt
        at = first + i
{set_given}{lags}        seen = readings({observed})
{out}        if watched.size > 0:
{read}            observed(i, read, watched, measured, gains, shown, leak, lead, moves)
{led}        if closed:
{y}            added = noise[i] if noise.size > 0 else 0.0
            control(i, t, dt, target[i], added, y, rule, memory, command)
            for j in range({inputs}):
                u[j, at] = command[j]
{push}        for k in range(substeps):
            middle = t + (k + 0.5) * h
            part, after = (k + 0.5) / substeps, min(i + 1, out.shape[0] - 1)
{signals}{given}            {state}, = step({_given(names, "middle")})
            done += 1
{ring}{store}    return done
"""


def _given(names: Names, time: str) -> str:
    return ", ".join(time if name == "t" else name for name in names.arguments)


_LATE = """\
@njit
def read_late(ring, row, step, lag):
    back = int(lag)
    newer = ring[row, (step - back) % ring.shape[1]]
    older = ring[row, (step - back - 1) % ring.shape[1]]
    return newer + (lag - back) * (older - newer)
"""


def source(s: Structure) -> str:
    """Return the text of the scalar engine of a structure."""
    parts = [
        head_text(s, kernels=not s.either),
        _LATE,
        observe_text(s),
        step_text(s),
        scalar_text(s),
    ]
    text = "\n\n".join(parts)
    # a state named as a coordinate's middle speed would hide it
    return compiled(text, "march")


def scalar_engine(s: Structure) -> Engine:
    """Return the compiled scalar loop of a structure, which `structure_of` gave."""
    return engine_by(s, "scalar", source)
