"""The paper's eight experiments (Figs 16 and 18, Tables 3 and 4), on logs of a rig.

A model is fitted on some logs and tested on others: the voltages of an open-loop log drive
it freely; a closed-loop log is simulated with its setpoint and the rig's PI loop. Speeds are
compared below 30 Hz, since after a reversal the pinions chatter at 230 Hz in a way that no
model predicts sample by sample.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.compared_signals import agreement, low_pass
from dmptm_ctrl.identify.records import block_mean
from dmptm_ctrl.signals import Campaign, Log
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import Loop, close_loop, march, rest
from dmptm_ctrl.simulate.model import Floats, Model

BLOCK = 10  # samples of 1 ms; the fit sees means over 10 ms
STEP = 0.05  # of half a declared range: beyond the roughness that impact chatter gives
STEP_OF_VALUE = 0.1  # at most, where the range is wide
PRIOR = 0.6  # standard deviation of a uniform range, as a share of its half-width
SPEED_ERROR = np.deg2rad(0.3)  # rad/s of a block: what even the true rig differs by
ITERATIONS = 12
STARTS = 2
INSIDE = 0.999  # of half a range: where a start may lie

# experiment → log, printed name, printed r of existing and proposed model [%]
EXPERIMENTS: Mapping[str, tuple[str, str, float, float]] = {
    "3a": ("open_sine_0v60", "0.6 sin(πt) V", 94.13, 99.41),
    "3b": ("open_sine_0v75", "0.75 sin(2πt) V", 97.47, 99.67),
    "3c": ("open_square_0v60", "0.6 square(0.8πt) V", 99.14, 99.68),
    "3d": ("open_square_0v75", "0.75 square(0.8πt) V", 99.30, 99.73),
    "4a": ("closed_sine_10", "10 sin(πt) deg/s", 98.53, 99.17),
    "4b": ("closed_sine_15", "15 sin(2πt) deg/s", 98.13, 98.66),
    "4c": ("closed_square_10", "10 square(πt) deg/s", 92.77, 94.42),
    "4d": ("closed_square_15", "15 square(2πt) deg/s", 82.75, 83.70),
}
# Each half is tested with a fit on the other; the multisine under preload is in both fits.
HALVES = (("3a", "3c", "4a", "4c"), ("3b", "3d", "4b", "4d"))
ALWAYS = ("open_multisine_preload",)


class Score(NamedTuple):
    """How near a simulated speed is to a measured one, both below 30 Hz."""

    pearson_r: float
    fit_percent: float  # 100 (1 − ‖error‖/‖measured − mean‖)
    rmse: float  # rad/s


class Trial(NamedTuple):
    """One experiment: what was measured and what two models say. (n,) arrays [s, rad/s]."""

    experiment: str
    time: Floats
    measured: Floats
    speeds: dict[str, Floats]
    scores: dict[str, Score]


def score(measured: Floats, simulated: Floats) -> Score:
    """Compare two signals; r alone ignores a wrong gain and offset, the others do not."""
    return Score(**agreement([(measured, simulated)]))


def speed_on(model: Model, log: Log, loop: Loop) -> Floats:
    """Simulate a log's ring-gear speed [rad/s], (n,).

    Open loop: free run on its voltages. Closed loop (it has ``ref``): its setpoint under
    `loop`.
    """
    dt, theta = log.sample_time, float(log["theta_L"][0])
    if "ref" in log:
        return close_loop(model, loop, log["ref"], dt, theta_L=theta)[1][:, 1]
    u = np.array([log["u_left"], log["u_right"]])
    return march(model, u, _at_rest(model, log), dt)[:, 1]


def speeds_on(models: Sequence[Model], log: Log, loop: Loop) -> Floats:
    """Simulate :func:`speed_on` of many models at once [rad/s], (models, n)."""
    if len(models) == 1:  # lanes that nothing fills take as long
        return speed_on(models[0], log, loop)[None]
    closed = "ref" in log
    runs = simulate_batch(
        models,
        log.sample_time * np.arange(log.time.size),
        log["ref"] if closed else np.array([log["u_left"], log["u_right"]]),
        np.array([_at_rest(model, log) for model in models]),
        loop=loop if closed else None,
        outputs=("omega_L",),
    )
    return runs.outputs[:, 0]


def _at_rest(model: Model, log: Log) -> Floats:
    """Return the state in which a log begins, (6,)."""
    theta = float(log["theta_L"][0])
    motors = [log[c][0] for c in ("theta_ml", "theta_mr") if c in log and "ref" not in log]
    return rest(model, theta, motors=motors if len(motors) == 2 else None)


def fit_to_logs(drive: Drive, logs: Sequence[Log], loop: Loop, *, starts: int = STARTS) -> Drive:
    """Fit all free parameters of a drive to the speeds of logs, inside their ranges.

    The same for every model, so that none is favoured: least squares on 10 ms means, every
    log with the same weight, a weak pull to the middle of the declared ranges, the best of
    several starts.

    Parameters
    ----------
    drive : Drive
        Declares which parameters are free and their ranges; its values are the first start.
    loop : Loop
        Of the closed-loop logs.
    starts : int
        The others are scattered over the ranges.
    """
    names = drive.free
    low, high = np.array([drive.quantities[n].range for n in names]).T
    declared = np.array([drive[n] for n in names])
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    measured = [block_mean(log["omega_L"], BLOCK) for log in logs]

    def place(p: Floats) -> Drive:
        return drive.with_values(**dict(zip(names, (middle + half * p).tolist(), strict=True)))

    def residuals(several: Floats) -> Floats:
        models = [Model(place(p)) for p in several]
        parts = [several / PRIOR]
        for log, seen in zip(logs, measured, strict=True):
            miss = (seen - block_mean(speeds_on(models, log, loop), BLOCK)) / SPEED_ERROR
            parts.append(miss * np.sqrt(100.0 / seen.size))  # a log counts as 100 independent rows
        return np.concatenate(parts, axis=1)

    def steps(p: Floats) -> Floats:
        # Small beside the value too: a range from 0 to 2000 says nothing of the scale.
        by_value = STEP_OF_VALUE * np.abs(middle + half * p) / half
        return np.clip(by_value, 1e-3 * STEP, STEP)

    rng = np.random.default_rng(0)
    wide = half > np.abs(declared)
    found = []
    for i in range(starts):
        start = declared
        if i > 0:
            start = np.where(
                wide, declared * np.exp(rng.normal(size=low.size)), rng.uniform(low, high)
            )
        p = np.clip((start - middle) / half, -INSIDE, INSIDE)
        found.append(_gauss_newton(residuals, p, steps))
    return place(min(found, key=lambda fit: fit[0])[1])


def _gauss_newton(
    residuals: Callable[[Floats], Floats], p: Floats, steps: Callable[[Floats], Floats]
) -> tuple[float, Floats]:
    """Bounded Gauss–Newton with difference steps above impact chatter: cost and place."""

    def residual(p: Floats) -> Floats:
        return residuals(p[None])[0]

    def jacobian(p: Floats) -> Floats:
        ends = p + np.diag(np.where(p < 0.0, 1.0, -1.0) * steps(p))
        missed = residuals(np.vstack([p, ends]))
        return (missed[1:] - missed[0]).T / np.diag(ends - p)

    fit = least_squares(
        residual, p, jac=jacobian, bounds=(-1.0, 1.0), max_nfev=ITERATIONS, ftol=1e-3
    )
    return float(fit.cost), np.asarray(fit.x)


def validate(
    campaign: Campaign,
    drives: Mapping[str, Drive],
    loop: Loop,
    *,
    progress: Callable[[str], None] | None = None,
) -> tuple[list[Trial], dict[str, list[Drive]]]:
    """Fit models on one half of the experiments and judge them on the other, both ways.

    Parameters
    ----------
    campaign : Campaign
        With the logs of :data:`EXPERIMENTS` and the multisine under preload.
    drives : mapping of str to Drive
        Models by name, fitted alike.
    loop : Loop
        The rig's.
    progress : function of str, optional
        Called before each fit.

    Returns
    -------
    trials : list of Trial
        In the order of the paper's tables.
    fitted : dict of str to list of Drive
        For each half.

    Raises
    ------
    KeyError
        A log that the campaign does not have.
    """
    trials: dict[str, Trial] = {}
    fitted: dict[str, list[Drive]] = {name: [] for name in drives}
    for tested, learned in (HALVES, HALVES[::-1]):
        logs = [campaign[name] for name in (*(EXPERIMENTS[e][0] for e in learned), *ALWAYS)]
        models = {}
        for name, drive in drives.items():
            if progress is not None:
                progress(f"{name} model, fitted on {', '.join(learned)}")
            fitted[name].append(fit_to_logs(drive, logs, loop))
            models[name] = Model(fitted[name][-1])
        for experiment in tested:
            log = campaign[EXPERIMENTS[experiment][0]]
            dt = log.sample_time
            measured = low_pass(log["omega_L"], dt)
            speeds = {n: low_pass(speed_on(m, log, loop), dt) for n, m in models.items()}
            scores = {n: score(measured, speed) for n, speed in speeds.items()}
            trials[experiment] = Trial(experiment, log.time, measured, speeds, scores)
    return [trials[e] for e in EXPERIMENTS], fitted
