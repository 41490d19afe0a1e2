"""What each thing is worth: the rise of the true rig's held-out error without it.

The true rig and the rig without the thing are run on the voltages of the held-out logs,
without noise. Twins, the same rig with meshes of slightly other stiffness, give the error
that nobody gets below: rattle after reversals makes them land elsewhere.
"""

import numpy as np
from scipy.signal import butter, sosfiltfilt

from rigs.experiments import GAINS, Experiment
from rigs.nominal import DEG, REDUCER_RATIO, RING_RATIO
from rigs.plant import SAMPLE, record_log

STEP = 5e-5  # s; all runs that are compared have the same
TWINS, TWIN_SPREAD = 3, 1e-3
BANDS = {"speed_below_30_Hz_deg_s": 30.0, "speed_below_5_Hz_deg_s": 5.0}
ERROR = "transmission_error_arcsec"
# Material: the error rises by what a user can see, and by more than chance does.
SEEN = {"speed_below_30_Hz_deg_s": 0.02, "speed_below_5_Hz_deg_s": 0.02, ERROR: 6.0}
CHANCE = 3.0  # standard deviations of the twins


def replayed(record, experiment, table):
    """Gyro [deg/s] and transmission error [arcsec] of one log's voltages, without noise."""
    left, right = table["u_left_V"].to_numpy(), table["u_right_V"].to_numpy()
    same = Experiment(False, 0.5 * (left + right), experiment.start, 0.5 * (left - right).mean())
    raw = record_log(
        record[0], same.signal, False, GAINS, same.preload, same.start,
        np.zeros(left.size), round(SAMPLE / STEP),
    )  # fmt: skip
    if not np.isfinite(raw).all():
        raise FloatingPointError("the rig's simulation left the finite numbers")
    twist = 0.5 * (raw[4] + raw[5]) / (REDUCER_RATIO * RING_RATIO) - raw[2]
    return raw[3] / DEG, twist / DEG * 3600


def errors(runs, truth):
    """RMS over all held-out logs of what separates two sets of runs, per channel."""
    square = dict.fromkeys((*BANDS, ERROR), 0.0)
    for (speed, twist), (true_speed, true_twist) in zip(runs, truth, strict=True):
        for name, band in BANDS.items():
            square[name] += np.sum(low_pass(speed - true_speed, band) ** 2)
        square[ERROR] += np.sum(low_pass(twist - true_twist, 30.0) ** 2)
    count = sum(speed.size for speed, _ in truth)
    return {name: float(np.sqrt(s / count)) for name, s in square.items()}


def low_pass(signal, band):
    return sosfiltfilt(butter(4, band, fs=1 / SAMPLE, output="sos"), signal)


def label(rig, twins=TWINS):
    """The entry of labels.json of a rig that was made with hidden logs."""

    def runs(record):
        return [replayed(record, rig.experiments[n], rig.hidden[n]) for n in rig.hidden]

    recipe = rig.recipe
    truth = runs(rig.record)
    factors = 1.0 + TWIN_SPREAD * np.random.default_rng(0).standard_normal((twins, 2))
    same = [errors(runs(recipe.record(meshes=tuple(f))[0]), truth) for f in factors]
    floor = {name: np.mean([e[name] for e in same]) for name in same[0]}
    spread = {name: np.std([e[name] for e in same], ddof=1) for name in same[0]}
    encoders = rig.label["sensors"] == "all"
    things = {}
    for key, (name, main) in recipe.things().items():
        found = errors(runs(recipe.record(without=(key,))[0]), truth)
        rise = {channel: found[channel] - floor[channel] for channel in found}
        seen = {channel for channel in rise if encoders or channel != ERROR}
        things[key] = {
            "name": name,
            "main": main,
            "material": any(rise[c] >= max(SEEN[c], CHANCE * spread[c]) for c in seen),
        } | {f"rise_{channel}": round(float(value), 4) for channel, value in rise.items()}
    bare = errors(runs(recipe.record(without=tuple(recipe.things()))[0]), truth)
    named = [name for name, main in recipe.things().values() if main and name]
    made = rig.label
    unlisted = [n for n, _ in recipe.effects if n not in named]
    entry = {
        "main_effects": named,
        "strengths": made["strengths"],
        "friction": made["laws"]["friction"],
        "contact": made["laws"]["contact"],
        "motor_encoders": encoders,
        "floor_of_twins_deg_s": round(float(floor["speed_below_30_Hz_deg_s"]), 4),
        "without_the_effects_deg_s": round(bare["speed_below_30_Hz_deg_s"], 4),
        "things": things,
        "seed": made["seed"],
        "parameters": made["effect_parameters"],
    }
    if unlisted:
        entry |= {"on_no_list": unlisted[0], "depends_on_any_of": made["depends_on"]}
    return entry
