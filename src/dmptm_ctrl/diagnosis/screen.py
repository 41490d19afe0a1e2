"""Before the first step: which logs can be diagnosed at all, and which mistakes show at once.

A log that cannot show anything is left out with a warning. Units and signs that a whole rig's
logs share contradict nothing inside a log; they show against the declared model.
"""

import numpy as np

from dmptm_ctrl.diagnosis.measure import MIN_SAMPLES
from dmptm_ctrl.diagnosis.predict import free_run
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.motion import (
    CREEP,
    SMOOTH_SECONDS,
    WINDOW_SECONDS,
    odd_span,
    one_way,
    smooth,
)
from dmptm_ctrl.signals import Campaign, Log, LogError, MissingChannelError
from dmptm_ctrl.signals.plausible import MISTAKES, NAMED, lean, refuse_inconsistent
from dmptm_ctrl.simulate.model import Model

NEEDED = ("u_left", "u_right", "theta_L", "omega_L")
MIN_SECONDS = 2.0  # longer than the longest memory that the unknown effects are tried with
MIN_MOVING = 0.5  # s in motion
MAX_TWIST = np.deg2rad(20.0)  # rad at the pinion; gaps and shafts give minutes of arc
READ_ROWS = 2_000_000  # of a file; what comes after is not read
MAX_ROWS = 300_000  # of a log; tables over all rows then stay below a gigabyte
FASTEST_HZ = 2000.0  # sampled faster, a log is thinned to half of this or more
SLOWEST_HZ = 200.0  # sampled slower, the mesh mode at 60 Hz is not seen
STRANGE = 5.0  # factor between the speeds of log and declared model: no drive of that kind
VAGUE = 2.0  # factor within which the speed of a declared model is right
LEAN = 0.3  # correlation of voltage and speed that shows the sign of a motor's power
TRIED_SECONDS = 20.0  # of each log, run on the declared model


def screen(campaign: Campaign, drive: Drive) -> tuple[Campaign, tuple[str, ...]]:
    """Choose the logs that can be diagnosed, beside the declared model.

    And warnings: what was left out, shortened or looks wrong; each log has its own besides.
    LogError where no log is left, or all share a mistaken unit or sign.
    """
    warnings = list(campaign.warnings)
    useless: dict[str, str] = {}
    for log in campaign:
        if missing := [channel for channel in NEEDED if channel not in log]:
            raise MissingChannelError(
                f"{log.name}: no channel {missing[0]!r}; it has {', '.join(log.channels)}. "
                "Other columns, or another drive, need a rig file: dmptm rig init writes one"
            )
        refuse_inconsistent(log, drive["N_1"] * drive["N_2"])
        refuse_one_sign(log)
        if why := nothing_in(log):
            useless[log.name] = why
    refuse_other_drive([log for log in campaign if log.name not in useless], drive)
    kept = []
    for log in campaign:
        if why := useless.get(log.name) or poor(log, drive):
            useless[log.name] = why
            continue
        short, notes = shortened(log)
        kept.append(short)
        warnings += [f"{log.name}: {note}" for note in notes]
    reasons = [f"{name} {why}" for name, why in useless.items()]
    if not kept:
        raise LogError(f"nothing to diagnose: {'; '.join(reasons)}")
    return Campaign(tuple(kept)), (*warnings, *(f"left out: {text}" for text in reasons))


def nothing_in(log: Log) -> str:
    """Return why a log cannot show anything; empty if it can."""
    if len(log) < MIN_SAMPLES or log.duration < MIN_SECONDS:
        return (
            f"is too short: {len(log)} samples, {log.duration:.3g} s; "
            f"needs {MIN_SAMPLES} and {MIN_SECONDS:g} s"
        )
    if not np.any(log["u_left"]) and not np.any(log["u_right"]):
        return "has no voltage: u_left and u_right are 0 V all the time"
    still = [channel for channel in ("theta_L", "omega_L") if np.ptp(log[channel]) == 0]
    if len(still) == 2:
        return "has no motion: theta_L and omega_L stay where they are"
    if still:
        other = "omega_L" if still == ["theta_L"] else "theta_L"
        return f"has a stuck sensor: {still[0]} stays where it is while {other} changes"
    return ""


def poor(log: Log, drive: Drive) -> str:
    """Return what a log lacks beside its drive: motion, or an encoder of it; empty if nothing."""
    moving = seconds_of_motion(log)
    if moving < MIN_MOVING:
        return f"hardly moves: {moving:.2g} s of steady motion; needs {MIN_MOVING:g} s"
    for channel in ("theta_ml", "theta_mr"):
        if log.has(channel):
            twist = float(np.ptp(log[channel] / drive["N_1"] - drive["N_2"] * log["theta_L"]))
            if twist > MAX_TWIST:
                return (
                    f"has a foreign or failing motor encoder: {channel} and theta_L part by "
                    f"{np.rad2deg(twist):.3g} deg of the pinion, where a drive twists by minutes"
                )
    return ""


def seconds_of_motion(log: Log) -> float:
    """Time in windows throughout which the ring gear moves one way [s]."""
    dt = log.sample_time
    m = 2 * max(3, round(0.5 * WINDOW_SECONDS / dt))
    omega = smooth(log["omega_L"], odd_span(SMOOTH_SECONDS, dt))
    if omega.size <= m + 2:
        return 0.0
    windows = one_way(omega, CREEP, m, np.arange(1, omega.size - m - 1, m // 2))
    return float(windows.sum() * (m // 2) * dt)


def refuse_one_sign(log: Log) -> None:
    """Refuse a log in which one motor brakes all the time while the other one drives.

    A lasting difference, the preload, does not count: means are taken off.
    """
    speed = log["omega_L"] - log["omega_L"].mean()
    leans = {c: lean(log[c] - log[c].mean(), speed) for c in ("u_left", "u_right")}
    if min(leans.values()) < -LEAN and max(leans.values()) > LEAN:
        wrong = min(leans, key=lambda channel: leans[channel])
        raise LogError(
            f"{log.name}: {wrong} works against the motion and the other motor's voltage over the "
            f"whole log: {wrong} has the wrong sign"
        )


def shortened(log: Log) -> tuple[Log, list[str]]:
    """Thin a log that is sampled too fast and cut one that is too long; say so."""
    notes = []
    rate = 1.0 / log.sample_time
    if rate < SLOWEST_HZ:
        notes.append(
            f"sampled at {rate:.4g} Hz; below {SLOWEST_HZ:g} Hz fast effects (delays, meshes) "
            "cannot be identified"
        )
    every = int(rate * 2.0 / FASTEST_HZ) if rate > FASTEST_HZ else 1
    if every > 1:
        log = thinned(log, every)
        notes.append(f"sampled at {rate:.6g} Hz; thinned to {1.0 / log.sample_time:.6g} Hz")
    if len(log) > MAX_ROWS:
        short = log.segment(float(log.time[0]), float(log.time[MAX_ROWS - 1]))
        notes.append(f"the first {short.duration:.6g} s of {log.duration:.6g} s are used")
        log = short
    return log, notes


def thinned(log: Log, every: int) -> Log:
    """Return every n-th sample; voltages, which are held, averaged until the next one."""
    rows = len(log) // every * every
    channels = {}
    for channel, values in log.channels.items():
        parts = values[:rows].reshape(-1, every)
        held = channel.startswith("u_")
        channels[channel] = parts.mean(axis=1) if held else parts[:, 0]
    units = dict(log.units)
    meta = dict(log.meta)
    return Log(log.name, log.time[:rows:every], channels, log.sha256, meta, units, log.warnings)


def refuse_other_drive(logs: list[Log], drive: Drive) -> None:
    """Refuse speeds that are far from those of the declared model under the same voltages."""
    if not logs:
        return
    model = Model(drive)
    seen = run = 0.0
    for log in logs:
        part = first_seconds(log)
        simulated = free_run(model, part, runs=1)[:, 1]
        seen += float(np.mean(part["omega_L"] ** 2))
        run += float(np.mean(simulated**2))
    ratio = np.sqrt(seen / run) if run > 0 else np.inf
    if 1.0 / STRANGE < ratio < STRANGE:
        return
    times = f"{ratio:.3g} times" if np.isfinite(ratio) else "large beside"
    near = mistakes_near(ratio)
    perhaps = f": perhaps {near[0]}" if near else ""
    raise LogError(
        f"the speeds in the logs are {times} those of the declared model under the same "
        f"voltages{perhaps}; mend the units of the logs, or declare this drive in a rig.toml"
    )


def mistakes_near(ratio: float) -> list[str]:
    """Return mistakes that a vague factor may be: the close ones first, of these the commonest."""
    off = {f: abs(np.log(ratio / f)) for f in MISTAKES} if 0.0 < ratio < np.inf else {}
    near = [f for f in off if off[f] < np.log(VAGUE)]
    return [MISTAKES[f] for f in sorted(near, key=lambda f: off[f] > np.log(NAMED))]


def first_seconds(log: Log) -> Log:
    """Return the first :data:`TRIED_SECONDS` of a log."""
    end = min(log.duration, TRIED_SECONDS)
    return log.segment(float(log.time[0]), float(log.time[0]) + end)
