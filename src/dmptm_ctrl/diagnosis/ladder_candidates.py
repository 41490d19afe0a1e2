"""What a drive of any shape may lack: every effect at every place, with starting values."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.diagnosis.ladder_score import Tangent
from dmptm_ctrl.diagnosis.ladder_tries import Candidate, backlash, compliance, finite
from dmptm_ctrl.drive.rig import DECLARES
from dmptm_ctrl.identify.chain_free import HARMONIC, Scales, absolute, on_slide, scales_of
from dmptm_ctrl.identify.chain_motion import Motion
from dmptm_ctrl.identify.inverse_dynamics import Balance, kinematic, measured_motion
from dmptm_ctrl.simulate.along import friction_along, torque_along
from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE, ChainEffect, may_stand
from dmptm_ctrl.simulate.chain_model import FAR, ChainModel, Placed

Floats = NDArray[np.float64]

MAX_ORDER = 400  # per turn
SCREENED = 8  # orders and frequencies of the screening that are looked at closely
LEAST_PERIODS = 3.0  # in the travel, or a spring or a slope would do as well
MIN_TURNS = 0.9  # of travel before an angle effect of order 1 is told from a slope
DELAYS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # sample times
LONGEST_DELAY = 0.2  # s
BACKGROUND = {  # no candidates: absorbed by the declared model, or judged sensor against sensor
    "sensor_gain", "encoder_eccentricity", "sensor_delay", "local_spot",
}  # fmt: skip


def candidates(tangent: Tangent, *, structure: bool = True) -> list[Candidate]:
    """Score every effect at every place on what a fit has left.

    Parameters
    ----------
    structure : bool
        Also those that add a coordinate or a gap, which cost most.

    Returns
    -------
    list of Candidate
        The best starting values of each effect at each place; largest gain first.
    """
    found = []
    for place in _places(tangent):
        found += list(place)
    if structure:
        found += structures(tangent)
    return sorted(found, key=lambda c: -c.score.gain)


def structures(tangent: Tangent) -> list[Candidate]:
    """Score springs and gaps, which change how many coordinates there are or cost most."""
    present = {(e.name, e.on) for e in tangent.fit.model.effects}
    scales = scales_of(tangent.balance)
    return [*compliance(tangent, present), *backlash(tangent, scales, present)]


def _places(tangent: Tangent) -> Iterator[Iterator[Candidate]]:
    model = tangent.fit.model
    scales = scales_of(tangent.balance)
    present = {(e.name, e.on) for e in model.effects}
    for source in model.rig.inputs:
        for name in ("drive_offset", "drive_dead_band", "drive_saturation", "drive_delay",
                     "current_lag"):  # fmt: skip
            if (name, source.name) not in present:
                yield _input_effect(tangent, scales, name, source.name)
    for body in _distinct_bodies(tangent):
        for name, chain in CHAIN_CATALOGUE.items():
            if chain.place != "body" or name in BACKGROUND or name == "shaft_compliance":
                continue
            if (name, body) in present and name != "cogging":
                continue
            if declared_already(model, name, body) or not may_stand(chain, model.rig, body):
                continue
            yield _body_effect(tangent, scales, chain, body)


def declared_already(model: ChainModel, name: str, body: str) -> bool:
    """Whether the rig declares what an effect would add to a body."""
    if body.endswith(FAR):
        return name == "viscous_friction"  # part of the compliance that made the body
    friction = model.rig.body(body).friction
    keys = DECLARES.get(name, ())
    return any(k in friction for k in keys)


def _distinct_bodies(tangent: Tangent) -> list[str]:
    """One body per measured coordinate; rigidly joined bodies cannot be told apart."""
    model = tangent.fit.model
    motion = tangent.balance.motions[0]
    _, bodies = measured_motion(model, tangent.balance, motion)
    return list(bodies.values())


def _input_effect(tangent: Tangent, scales: Scales, name: str, on: str) -> Iterator[Candidate]:
    size = scales.u[on]
    dt = scales.dt
    motions = tangent.balance.motions
    peak = max(float(np.abs(m.u[on]).max()) for m in motions)
    if name == "drive_offset":
        yield finite(tangent, [Placed(name, on, {"offset": 0.02 * size})])
    elif name == "drive_dead_band":
        yield finite(tangent, [Placed(name, on, {"width": s * size}) for s in (0.01, 0.05, 0.15)])
    elif name == "drive_saturation":
        tries = [Placed(name, on, {"inverse_limit": 1.0 / (s * peak)}) for s in (0.95, 0.8, 0.6)]
        yield finite(tangent, tries)
    else:
        key = "delay" if name == "drive_delay" else "time_constant"
        values = [d * dt for d in DELAYS if d * dt <= LONGEST_DELAY]
        yield finite(tangent, [Placed(name, on, {key: v}) for v in values])


def _body_effect(
    tangent: Tangent, scales: Scales, chain: ChainEffect, body: str
) -> Iterator[Candidate]:
    model, balance = tangent.fit.model, tangent.balance
    name = chain.name
    slide = on_slide(model, body)
    if name in ("friction_asymmetry", "thermal_drift"):
        if not has_friction(model, body):
            return
        key = "difference" if name == "friction_asymmetry" else "rise"
        if name == "thermal_drift":
            longest = max(float(m.time[-1]) for m in balance.motions)
            taus = [longest * s for s in (0.1, 0.3, 1.0)]
            tries = [Placed(name, body, {key: 0.05, "time_constant": t}) for t in taus]
        else:
            tries = [Placed(name, body, {key: 0.05})]
        yield finite(tangent, tries)
    elif name == "presliding":
        if has_friction(model, body):
            sizes = [s * scales.position for s in (1e-5, 1e-4, 1e-3, 1e-2)]
            yield finite(tangent, [Placed(name, body, {"distance": s}) for s in sizes])
    elif name == "cogging":
        yield from _cogging(tangent, chain, body, slide)
    elif name == "unbalance":
        if not slide and turns(balance, model, body) >= MIN_TURNS:
            yield _amplitudes(
                tangent, chain, body, [{}], per_log=not absolute(model, balance, body)
            )
    elif name == "position_dependent_friction":
        if slide:
            yield _amplitudes(tangent, chain, body, [{}], names=("sine",))
        elif turns(balance, model, body) >= MIN_TURNS:
            yield _amplitudes(
                tangent, chain, body, [{}], per_log=not absolute(model, balance, body)
            )
    elif name == "stribeck_friction":
        fastest = max(float(np.abs(_speed(balance, m, model, body)).max()) for m in balance.motions)
        yield _amplitudes(
            tangent, chain, body, [{"speed": s * fastest} for s in (0.01, 0.03, 0.06, 0.12, 0.25)]
        )
    elif name == "base_vibration":
        yield from _vibration(tangent, chain, body)
    else:
        yield _amplitudes(tangent, chain, body, [{}])


def has_friction(model: ChainModel, body: str) -> bool:
    """Whether a body has any friction that a factor could change."""
    names = ("coulomb_friction", "viscous_friction", "stribeck_friction")
    if any(e.on == body and e.name in names for e in model.effects):
        return True
    return not body.endswith(FAR) and bool(model.rig.body(body).friction)


def _speed(balance: Balance, motion: Motion, model: ChainModel, body: str) -> Floats:
    measured, _ = measured_motion(model, balance, motion)
    layout = model.layout
    return layout.ratio[body] * measured[layout.coordinate[body]][1]


def _angle(balance: Balance, motion: Motion, model: ChainModel, body: str) -> Floats:
    measured, _ = measured_motion(model, balance, motion)
    layout = model.layout
    return layout.ratio[body] * measured[layout.coordinate[body]][0]


def turns(balance: Balance, model: ChainModel, body: str) -> float:
    return max(float(np.ptp(_angle(balance, m, model, body))) for m in balance.motions) / (
        2 * np.pi
    )


# -- by amplitude: linear ----------------------------------------------------------------------


def unit_columns(
    tangent: Tangent,
    chain: ChainEffect,
    body: str,
    shapes: dict[str, float],
    names: tuple[str, ...],
) -> list[Floats]:
    """Derivative of the residual by each amplitude, per log (equations, rows, p)."""
    balance, model = tangent.balance, tangent.fit.model
    reach = kinematic(model)[model.layout.coordinate[body]]
    r = model.layout.ratio[body]
    parts = []
    for motion in balance.motions:
        key = (motion.name, chain.name, body, tuple(sorted(shapes.items())), names, reach, r)
        if key not in balance.columns:
            theta, omega = (f(balance, motion, model, body) for f in (_angle, _speed))
            columns = []
            for name in names:
                placed = Placed(chain.name, body, {**shapes, name: 1.0})
                if chain.site == "friction":
                    load = np.sum([np.abs(u) for u in motion.u.values()], axis=0)
                    _, out = friction_along(placed, theta, omega, motion.time, load)
                    slow = motion.rest_share * np.abs(omega).max(initial=0.0)
                    out = -np.sign(omega) * out * (np.abs(omega) > slow)
                else:
                    out = torque_along(placed, theta, omega, motion.time)
                columns.append(motion.reduce(reach * r * out) * motion.moving)
            balance.columns[key] = np.array(columns).T
        parts.append(balance.columns[key])
    return [_in_equations(tangent, body, part, k) for k, part in enumerate(parts)]


def _in_equations(tangent: Tangent, body: str, column: Floats, log: int) -> Floats:
    """A torque on a body appears in the first equation, and in that of its own coordinate."""
    model, motion = tangent.fit.model, tangent.balance.motions[log]
    measured, _ = measured_motion(model, tangent.balance, motion)
    count = tangent.fit.left[log].shape[0]
    out = np.zeros((count, *column.shape))
    out[0] = column
    own = list(measured).index(model.layout.coordinate[body])
    if 0 < own < count:
        reach, plant = kinematic(model), model.plant()
        group = model.layout.coordinate[body]
        whole = sum(r**2 * plant.inertia[g] for g, r in reach.items())
        out[own] = column * whole / (reach[group] ** 2 * plant.inertia[group])
    return out


def _amplitudes(
    tangent: Tangent,
    chain: ChainEffect,
    body: str,
    shapes: list[dict[str, float]],
    *,
    names: tuple[str, ...] | None = None,
    per_log: bool = False,
    tries: int | None = None,
) -> Candidate:
    """Best of several shapes, amplitudes solved for."""
    names = names or chain.amplitudes
    best: Candidate | None = None
    logs = [m.name for m in tangent.balance.motions]
    for shape in shapes:
        parts = unit_columns(tangent, chain, body, shape, names)
        if per_log and len(parts) > 1:
            wide = []
            for k, part in enumerate(parts):
                padded = np.zeros((*part.shape[:2], part.shape[2] * len(parts)))
                padded[:, :, k * part.shape[2] : (k + 1) * part.shape[2]] = part
                wide.append(padded)
            score = tangent.score(tangent.stack(wide))
        else:
            score = tangent.score(tangent.stack(parts))
        pairs = score.amplitudes.reshape(-1, len(names))
        low = {p.name: p.low for p in chain.keep}
        if any(low[n] >= 0 and pairs[0][j] < 0 for j, n in enumerate(names)):
            score = score._replace(gain=0.0)  # friction that drives, a spring that pushes
        if best is not None and score.gain <= best.score.gain:
            continue
        values, zero = dict(shape), dict[str, float]()
        if per_log and len(parts) > 1 and chain.name in HARMONIC:
            values_0, zero = _common_phase(pairs, logs, shape.get("order", 1.0))
            values |= dict(zip(names, values_0, strict=True))
        else:
            values |= dict(zip(names, pairs[0], strict=True))
        best = Candidate(
            Placed(chain.name, body, {k: float(v) for k, v in values.items()}),
            score,
            tries or len(shapes),
            zero,
        )
    assert best is not None
    return best


def _common_phase(pairs: Floats, logs: list[str], order: float) -> tuple[Floats, dict[str, float]]:
    """One amplitude for all logs, and the shift of the angle in each after the first.

    C cos n(θ + z) + S sin n(θ + z) has the complex amplitude (C − iS) e^{inz}.
    """
    complex_ = pairs[:, 0] - 1j * pairs[:, 1]
    size = float(np.sqrt(np.mean(np.abs(complex_) ** 2)))
    first = complex_[0] / (abs(complex_[0]) or 1.0) * size
    zero = {
        log: float(np.angle(c / first) / order)
        for log, c in zip(logs[1:], complex_[1:], strict=True)
    }
    return np.array([first.real, -first.imag]), zero


def _cogging(tangent: Tangent, chain: ChainEffect, body: str, slide: bool) -> Iterator[Candidate]:
    model = tangent.fit.model
    orders, looked_at = _screen_orders(tangent, body, slide)
    present = [e.values["order"] for e in model.effects if e.name == "cogging" and e.on == body]
    width = 2 * np.pi / max(turns(tangent.balance, model, body) * 2 * np.pi, 1e-12)
    orders = [n for n in orders if all(abs(n - p) > width for p in present)]
    if present or not orders:
        return  # one order per place; harmonics follow as further rungs would blur the list
    yield _amplitudes(
        tangent,
        chain,
        body,
        [{"order": float(n)} for n in orders],
        names=("cosine", "sine"),
        per_log=not absolute(model, tangent.balance, body),
        tries=looked_at,
    )


def _screen_orders(tangent: Tangent, body: str, slide: bool) -> tuple[list[float], int]:
    """Orders at which the residual repeats with the angle, by FFT over the angle."""
    balance, model = tangent.balance, tangent.fit.model
    power: Floats | None = None
    orders: NDArray[np.floating] = np.zeros(0)
    spans = [float(np.ptp(_angle(balance, m, model, body))) for m in balance.motions]
    span = max(spans)
    if span <= 0:
        return [], 1
    for k, motion in enumerate(balance.motions):
        theta = _angle(balance, motion, model, body)
        speed = np.abs(_speed(balance, motion, model, body))
        left = tangent.fit.left[k][0]
        fine = np.interp(motion.time, motion.rows, left, left=0.0, right=0.0)
        if slide:
            bins = 16384
            place = np.clip((theta - theta.min()) / span * (bins // 2), 0, bins // 2 - 1)
            orders = 2 * np.pi * np.arange(bins // 2 + 1) * (bins // 2) / (bins * span)
        else:
            bins = 8192
            place = np.mod(theta, 2 * np.pi) / (2 * np.pi) * bins
            orders = np.arange(bins // 2 + 1).astype(float)
        sums = np.bincount(place.astype(int) % bins, fine, bins)
        fastest = 2 * np.pi * motion.bandwidth / np.maximum(orders, 1e-12)
        seen = np.searchsorted(np.sort(speed), fastest) / speed.size
        share = np.maximum(seen, 0.05)
        here = np.abs(np.fft.rfft(sums)) ** 2 / (share * theta.size)
        power = here if power is None else power + here
    assert power is not None
    lowest = LEAST_PERIODS * 2 * np.pi / span
    if not slide:
        lowest = max(lowest, 2.0)
    highest = min(MAX_ORDER, orders[-1]) if not slide else orders[-1] / 2
    slow = min(float(np.median(np.abs(_speed(balance, m, model, body)))) for m in balance.motions)
    highest = min(highest, 2 * np.pi * balance.bandwidth / max(slow, 1e-9) * 2)
    allowed = (orders >= lowest) & (orders <= highest)
    if not allowed.any():
        return [], 1
    peak = np.zeros_like(power, dtype=bool)
    peak[1:-1] = (power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])
    usable = np.flatnonzero(allowed & peak)
    best = usable[np.argsort(-power[usable])][:SCREENED]
    return [float(orders[i]) for i in best], int(allowed.sum())


def _vibration(tangent: Tangent, chain: ChainEffect, body: str) -> Iterator[Candidate]:
    """Frequencies at which the residual repeats with the clock."""
    motions = tangent.balance.motions
    spectra = []
    grid = np.linspace(0.5, 0.8 * tangent.balance.bandwidth, 2000)
    for k, motion in enumerate(motions):
        left = tangent.fit.left[k][0]
        size = 4 * left.size
        step = motion.dt * motion.step
        f = np.fft.rfftfreq(size, step)
        power = np.abs(np.fft.rfft(left, size)) ** 2
        spectra.append(np.interp(grid, f, power))
    total = np.sum(spectra, axis=0)
    longest = max(float(m.time[-1]) for m in motions)
    top = np.argsort(-total)[:1]
    fine = [float(grid[i]) for i in top]
    # the FFT's own grid, refined
    fine = [f + d / longest for f in fine for d in (-0.2, 0.0, 0.2)]
    yield _amplitudes(
        tangent, chain, body, [{"frequency": f} for f in fine], names=("cosine", "sine"),
        tries=int(longest * tangent.balance.bandwidth),
    )  # fmt: skip
