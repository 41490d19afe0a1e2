"""Runs of a rig on its held-out logs, free or with an observer, and what they miss."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf, pi
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.diagnosis.budget import Squares
from dmptm_ctrl.diagnosis.candidate import members
from dmptm_ctrl.diagnosis.predict import rms_excess, twin_steps
from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.identify.compared_signals import BANDWIDTH_HZ, agreement, low_pass, noise_below
from dmptm_ctrl.identify.heavy_tails import robust_scale
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.likelihood import LEAST_SCALE
from dmptm_ctrl.identify.measured_motion import MOTION_OVER_BALANCE, derivative, grid_of, of_part
from dmptm_ctrl.identify.rig_fit import RigFit
from dmptm_ctrl.identify.rig_simulate import (
    free_readings,
    free_run,
    in_lanes,
    readings,
    with_other_teeth,
)
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.signals import Log
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel, angle_body

if TYPE_CHECKING:
    from dmptm_ctrl.plots.diagnosis import Overlay

FEW = 4  # fewer runs go one after the other: a loop over lanes takes as long as they do


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of the models before and after on the inputs of held-out logs.

    Attributes
    ----------
    lead_hz : float
        Bandwidth of the observer that keeps short predictions near what was measured; 0 of free
        runs.
    sensor : Sensor
        That is compared: the first that measures speed, else the rate of the first. A free run
        of a position drifts without end, which says little of a model.
    bandwidth : float
        Of what is compared [Hz].
    logs : tuple of Log
        As read.
    held : tuple of (n,) arrays of bool
        Samples that are compared.
    before, after : list of (n,) arrays, or None
        Speeds in the sensor's unit; None where a run leaves all finite numbers.
    floor : float
        Scatter of models within the standard errors, and noise.
    """

    lead_hz: float
    sensor: Sensor
    bandwidth: float
    logs: tuple[Log, ...]
    held: tuple[NDArray[np.bool_], ...]
    before: list[Floats] | None
    after: list[Floats] | None
    floor: float
    jobs: int

    @classmethod
    def of(
        cls,
        rig: Rig,
        logs: Sequence[Log],
        balance: Balance,
        before: State,
        after: State,
        fit: RigFit,
        jobs: int,
        *,
        lead_hz: float = 0.0,
    ) -> "Runs":
        """Run the models before and after, and some within the standard errors of the latter."""
        bare = cls.none_yet(rig, logs, balance, jobs, lead_hz)
        runs = [bare.expected(state) for state in (before, after)]
        floor = bare.scatter(after, fit) if None not in runs else 0.0
        return replace(bare, before=runs[0], after=runs[1], floor=floor)

    @classmethod
    def none_yet(
        cls, rig: Rig, logs: Sequence[Log], balance: Balance, jobs: int, lead_hz: float = 0.0
    ) -> "Runs":
        """Return what models are run on, before any is."""
        named = {log.name: log for log in logs}
        parts = {m.name: m.part for m in balance.motions}
        held = tuple(named[name] for name in parts)
        masks = [of_part(parts[log.name], len(log)) for log in held]
        widest = min(BANDWIDTH_HZ, MOTION_OVER_BALANCE * balance.bandwidth)
        return cls(lead_hz, rig.speed_sensor, widest, held, tuple(masks), None, None, 0.0, jobs)

    @property
    def unit(self) -> str:
        """Of the sensor's column, per second where it measures a position."""
        return self.sensor.unit + "/s" * (self.sensor.measures == "position")

    def run(self, state: State) -> list[Floats] | None:
        """Run a model on every log; None where it leaves all finite numbers."""

        def one(log: Log) -> Floats:
            return self.seen(self.reading(state, log), log.sample_time)

        try:
            with np.errstate(all="ignore"):
                done = in_threads(one, self.logs, self.jobs, len)
        except (ValueError, ArithmeticError):  # values that no machine has
            return None
        return done if all(np.isfinite(run).all() for run in done) else None

    def run_all(self, states: Sequence[State]) -> list[list[Floats] | None]:
        """Run several models on every log, beside each other where runs are long."""
        if len(states) >= FEW:
            try:
                if in_lanes(states[0].model.opened, self.logs):
                    return self._in_lanes(states)
            except (ValueError, ArithmeticError):  # values of one that no machine has
                pass
        return [self.run(state) for state in states]

    def _in_lanes(self, states: Sequence[State]) -> list[list[Floats] | None]:
        def of(log: Log) -> list[Floats]:
            models = [self._on(state, log) for state in states]
            rows = free_readings(models, log, self.sensor.name, lead_hz=self.lead_hz)
            return [self.seen(row, log.sample_time) for row in rows]

        with np.errstate(all="ignore"):
            tables = in_threads(of, self.logs, self.jobs, len)
        each = ([*runs] for runs in zip(*tables, strict=True))
        return [runs if all(np.isfinite(run).all() for run in runs) else None for runs in each]

    def expected(self, state: State) -> list[Floats] | None:
        """Return the mean of runs with slightly other teeth and waves; without any, the run."""
        try:
            others = with_other_teeth(state.model.opened)
        except ValueError:  # values that no machine has
            return None
        several = self.run_all([state, *(replace(state, model=model) for model in others)])
        own = several[0]
        if any(runs is None for runs in several):
            return own
        return [np.mean(parts, axis=0) for parts in zip(*filter(None, several), strict=True)]

    def reading(self, state: State, log: Log) -> Floats:
        """What the sensor would have read of a model, (n,), SI."""
        model = self._on(state, log)
        run = free_run(model, log, lead_hz=self.lead_hz)
        return readings(model, log, run)[self.sensor.name]

    @staticmethod
    def _on(state: State, log: Log) -> RigModel:
        """Return a model as it runs on a log."""
        return state.model.opened.shifted(state.nuisance(log.name).zero)

    def seen(self, signal: Floats, dt: float) -> Floats:
        """What is compared of a reading [SI], in the sensor's unit."""
        shown = low_pass(signal, dt, self.bandwidth) / parse_unit(self.sensor.unit).factor
        return shown if self.sensor.measures == "speed" else derivative(shown, dt)

    @cached_property
    def measured(self) -> list[Floats]:
        """What the sensor read."""
        return [self.seen(log[self.sensor.channel], log.sample_time) for log in self.logs]

    def agreement(self, runs: Sequence[Floats]) -> dict[str, float]:
        """How far runs are from the readings, where nothing was fitted."""
        rows = zip(self.measured, runs, self.held, strict=True)
        return agreement([(seen[use], run[use]) for seen, run, use in rows])

    def misses(self, runs: Sequence[Floats]) -> list[Floats]:
        """What runs miss of the readings, where nothing was fitted."""
        rows = zip(self.measured, runs, self.held, strict=True)
        return [(seen - run)[use] for seen, run, use in rows]

    def missed(self, state: State) -> float:
        """What the runs of a model miss, root mean square; infinite where one diverges."""
        runs = self.expected(state)
        return inf if runs is None else self.agreement(runs)["rmse"]

    def scatter(self, after: State, fit: RigFit) -> float:
        """Scatter of runs of models within the standard errors of a fit, and noise.

        And what no law is known below, as in the balance: a share of the speed, as of the torque.
        """
        twins = []
        near = (fit.state.after(fit.frees, steps) for steps in twin_steps(fit.covariance))
        for runs in self.run_all([after.moved(fit.frees, values) for values in near]):
            if runs is not None:
                joined = zip(runs, self.held, strict=True)
                twins.append(np.concatenate([run[use] for run, use in joined]))
        variance = float(np.mean(np.var(twins, axis=0, ddof=1))) if len(twins) > 1 else 0.0
        noise = [self._noise(log, partial(self.reading, after, log)) for log in self.logs]
        speeds = [seen[use] for seen, use in zip(self.measured, self.held, strict=True)]
        unknown = LEAST_SCALE**2 * float(np.mean(np.square(np.concatenate(speeds))))
        return float(np.sqrt(variance + np.mean(np.square(noise)) + unknown))

    def _noise(self, log: Log, read: Callable[[], Floats]) -> float:
        """Noise of the readings in the band; of a rate by ∫ (2πf)² over it.

        Rounding alone is no white noise where a motion is slow: what a run would `read` is
        rounded, and compared with what it was.
        """
        signal, dt = log[self.sensor.channel], log.sample_time
        step = grid_of(self.sensor, signal)
        if step > noise_below(signal, 1.0, 0.5):
            run = read()
            rounded = self.seen(np.round(run / step) * step, dt) - self.seen(run, dt)
            return float(np.sqrt(np.mean(rounded**2)))
        white = noise_below(signal, dt, self.bandwidth) / parse_unit(self.sensor.unit).factor
        rate = 2.0 * np.pi * self.bandwidth / np.sqrt(3.0)
        return white if self.sensor.measures == "speed" else white * float(rate)

    def error(self) -> dict[str, dict[str, Any]] | None:
        """Errors before and after, and their floor; None where a run has none."""
        if self.before is None or self.after is None:
            return None
        sides: dict[str, dict[str, Any]] = {
            "before": self.agreement(self.before), "after": self.agreement(self.after),
        }  # fmt: skip
        sides["floor"] = {"rmse": min(self.floor, *(s["rmse"] for s in sides.values()))}
        same: dict[str, Any] = {
            "unit": self.unit, "bandwidth_hz": self.bandwidth, "sensor": self.sensor.name,
        }  # fmt: skip
        if self.lead_hz:
            same["seconds"] = round(0.5 / (pi * self.lead_hz), 3)  # of its memory
        return {k: {**v, **same} for k, v in sides.items()}

    @property
    def squares(self) -> Squares | None:
        """Mean squares of the errors before and after, and of their floor."""
        error = self.error()
        if error is None:
            return None
        return Squares(*(error[side]["rmse"] ** 2 for side in ("before", "after", "floor")))

    @property
    def usual(self) -> Squares | None:
        """Squares of what runs miss as a rule: bursts after impacts are chance and hardly count."""
        if self.before is None or self.after is None:
            return None
        sides = (self.before, self.after)
        before, after = (robust_scale(np.concatenate(self.misses(runs))) for runs in sides)
        return Squares(before**2, after**2, min(self.floor, before, after) ** 2)

    def rise(self, without: State) -> float | None:
        """What the error of the free runs rises by with another model, root mean square."""
        runs = self.expected(without) if self.error() is not None else None
        if runs is None or self.after is None:
            return None
        return rms_excess(*(self.agreement(r)["rmse"] for r in (runs, self.after)))

    def left(self) -> tuple[float | None, float | None]:
        """What of the error is not explained, and its floor."""
        error = self.error()
        if error is None:
            return None, None
        after, floor = error["after"]["rmse"], error["floor"]["rmse"]
        return rms_excess(after, floor), floor

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence where there is no free run."""
        if self.error() is not None:
            return ()
        return ("a free run on the held-out logs leaves all finite numbers; no free-run error",)

    def overlays(self) -> "list[Overlay]":
        """Measured, before and after on each log."""
        from dmptm_ctrl.plots.diagnosis import Overlay

        if self.before is None or self.after is None:
            return []
        rows = zip(self.logs, self.measured, self.before, self.after, self.held, strict=True)
        return [
            Overlay(
                log.name, log.time, seen, old, new, held, self._push(log), unit=self.unit
            )
            for log, seen, old, new, held in rows
        ]  # fmt: skip

    def _push(self, log: Log) -> Floats:
        inputs = [v for k, v in log.channels.items() if k.startswith("in_")]
        return low_pass(np.mean(inputs, axis=0), log.sample_time, self.bandwidth)


def variable_of(model: RigModel, key: str) -> str:
    """What an effect depends on, of the body that it acts on: as in `depends_on`."""
    name, _, on = members(key)[0].partition("@")
    wanted = PLACED_CATALOGUE[name].effect.depends_on[0]
    kind = wanted.partition("_")[0]
    if kind not in ("theta", "omega", "mesh"):
        return wanted
    layout = model.layout
    places = {**layout.sensor_body, **layout.input_body}
    here = angle_body(model, Placed(name, on))
    body = here if PLACED_CATALOGUE[name].place == "link" else places.get(on, here)
    return f"{'theta' if kind == 'mesh' else kind}:{body}"
