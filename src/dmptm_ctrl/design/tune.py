"""From a model to a controller: linear start, then the nonlinear drive over its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from dmptm_ctrl.control.sections import sampled_notch
from dmptm_ctrl.control.shaping import (
    LinearReference,
    Notched,
    SampledPlant,
    fastest_pi,
    linear_reference,
    notched_pi,
)
from dmptm_ctrl.control.tuning import PiTuning
from dmptm_ctrl.design.aims import Aims, error_unit, tracking
from dmptm_ctrl.design.compensation import QUANTILE, predicted_parts, what_pays
from dmptm_ctrl.design.controller import Controller, Notch
from dmptm_ctrl.design.draws import DECLARED, draw_plants, hidden_distance
from dmptm_ctrl.design.linear import DERIVATIVE, level, linear_plant, linear_rig
from dmptm_ctrl.design.preload import smallest_preload
from dmptm_ctrl.design.rig_aims import rig_aims
from dmptm_ctrl.simulate.any_model import AnyModel, effects_of, loop_parts
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.rig_model import RigModel

SEARCHED = 16  # plants in the search; the result is evaluated on many more
RESERVE = 1.6  # gain up to which no drawn plant may start to hammer: 4 dB on the nonlinear drive
TOLERATED = 1.5  # error at that gain, over the error at the gain itself
# of the distance over which friction may build up hidden
START_DISTANCE = 0.28  # taken at first
DISTANCES = (0.14, 0.42, 0.56, 0.7)  # tried besides
# points of the predicted gain over the measured one, of a dual-motor drive and of a rig file;
# docs/compensation.md
OPTIMISM = {False: (0, 8), True: (0, 3)}
AT_BODIES = "motor", "load", "friction"  # sites of effects that push or brake a body
WITHOUT = "PI, optimised"  # stage of the best controller without compensation
SLOWER = (1.0, 0.8, 0.63, 0.5, 0.4, 0.32)  # crossovers tried, of the linear design's
MORE_PRELOAD = (1.0, 1.4, 2.0)  # preloads tried, of the least that keeps the meshes closed
# first moves of the search: friction share, preload, lead in samples, share of that distance
_STEPS = (0.05, 0.2, 0.4, 0.14)
_EVALUATIONS = 32


@dataclass(frozen=True, eq=False)
class Tuned:
    """A controller and how it was found."""

    controller: Controller
    linear: PiTuning  # the start
    # what no linear controller beats on the drive without torques that depend on an angle; None
    # where the synthesis has no answer
    reference: LinearReference | None
    # Error over the drawn plants after each stage: stage, rmse_median, rmse_quantile, rmse_worst
    # [deg/s], voltage_max [V], controller, errors. Of a rig all are in SI units of its sensor and
    # its input.
    stages: list[dict[str, Any]]
    errors: Floats  # (plants,) deg/s, RMS tracking error on every plant drawn
    aims: Aims
    # What each part of the compensation takes off the error, alone, as shares of the error without
    # it: ``median``, and ``sure``, which nine of ten drawn plants reach.
    parts: pd.DataFrame

    @property
    def without(self) -> Controller:
        """The best controller without compensation, tuned to the same plants."""
        return self._without["controller"]

    @property
    def gains(self) -> Floats:
        """Predicted share of the error that the compensation takes off, on each drawn plant."""
        return np.asarray(1.0 - self.errors / self._without["errors"])

    @property
    def _without(self) -> dict[str, Any]:
        return next(row for row in self.stages if row["stage"] == WITHOUT)

    @property
    def unit(self) -> str:
        """Unit of the errors."""
        return error_unit(self.controller)[0]

    def summary(self) -> str:
        """Return the stages as a text."""
        volt, rad = self.controller.units
        title, largest = f"rms error [{self.unit}] on drawn plants", f"largest {volt}"
        lines = [f"{title:34s}{'median':>9s}{'90 %':>9s}{'worst':>9s}{largest:>11s}"]
        for row in self.stages:
            lines.append(
                f"{row['stage']:34s}{row['rmse_median']:9.3g}{row['rmse_quantile']:9.3g}"
                f"{row['rmse_worst']:9.3g}{row['voltage_max']:11.3g}"
            )
        g = self.controller
        preload = f", preload {g.preload:.3g} {volt}" if g.preload else ""
        lines += [
            "",
            f"kp {g.kp:.4g} {volt}/({rad}/s), ki {g.ki:.4g} {volt}/{rad}{preload}, "
            f"{g.friction:.0%} of the friction fed forward, rising over {1e6 * g.distance:.0f} "
            f"µ{rad} of motion, look-ahead {1e3 * g.lead:.2f} ms",
            *(f"notch at {n.hz:.1f} Hz, depth {n.depth:g}, width {n.width:g}" for n in g.notches),
            f"linear start: bandwidth {self.linear.bandwidth_hz:.1f} Hz, "
            f"phase margin {self.linear.phase_margin_deg:.0f} deg, "
            f"gain margin {self.linear.gain_margin_db:.1f} dB",
        ]
        median, sure = np.quantile(self.gains, [0.5, 1.0 - QUANTILE])
        least, most = OPTIMISM[isinstance(self.controller.model, RigModel)]
        lines.append(
            f"the compensation takes off {median:.0%} of the error; on nine of ten plants at "
            f"least {sure:.0%}; on drives of an independent program it was {least} to {most} "
            "points less"
        )
        lines += [
            f"  by {name}: {round(median, 2) + 0.0:.0%}, at least {round(sure, 2) + 0.0:.0%}"
            for name, median, sure in self.parts.itertuples()
        ]
        if homed := to_be_homed(self.controller.model):
            lines.append(
                f"needs the encoder at the zero of the model's first log: {', '.join(homed)}; "
                "from another zero they can make the error larger"
            )
        if self.reference is not None:
            lines.append(
                f"largest weighted gain of its linear loop {self.reference.reached:.2f}, of the "
                f"best linear controller (mixsyn) {self.reference.optimal:.2f}"
            )
        return "\n".join(lines)

    __str__ = summary

    def to_dict(self) -> dict[str, Any]:
        """Return the content of tuning.json: plain types."""
        return {
            "schema": 1,
            "stages": [
                {k: v for k, v in row.items() if k not in ("controller", "errors")}
                for row in self.stages
            ],
            "plants": int(self.errors.size),
            "quantile": QUANTILE,
            "unit": self.unit,
            "compensation": {
                "median": float(np.median(self.gains)),
                "sure": float(np.quantile(self.gains, 1.0 - QUANTILE)),
                "parts": self.parts.to_dict("index"),
            },
            "linear": {
                "bandwidth_hz": self.linear.bandwidth_hz,
                "phase_margin_deg": self.linear.phase_margin_deg,
                "gain_margin_db": self.linear.gain_margin_db,
                "weighted_peak": None if self.reference is None else self.reference.reached,
                "mixsyn_peak": None if self.reference is None else self.reference.optimal,
            },
        }


def tune_controller(
    model: AnyModel,
    aims: Aims | None = None,
    *,
    uncertainty: float = DECLARED,
    plants: int = 1000,
    seed: int = 0,
    jobs: int = -1,
    input: str = "",
    sensor: str = "",
) -> Tuned:
    """Design a speed controller on a model and its uncertainty.

    The start is the fastest PI that keeps the margins on the linearised model; then
    bandwidth, share of friction, preload and lead are searched on the nonlinear model, for
    the 0.9 quantile of the tracking error over drawn plants, on condition that at 1.6 times
    the gain the worst of them is not much worse. No step of the search leaves the margins.

    Parameters
    ----------
    model : Model or RigModel
        Declared, or augmented by a diagnosis.
    aims : Aims, optional
        Of a rig by default :func:`~dmptm_ctrl.design.rig_aims.rig_aims`.
    uncertainty : float
        Share of the declared ranges that plants are drawn from: 1 for a declared model, 0.25
        for one fitted to logs.
    plants : int
        Drawn to evaluate the result.
    seed : int
    jobs : int
        Threads, −1 for one per core; or tasks on any joblib backend.
    input, sensor : str
        Of a rig: the motor, and the sensor whose speed is controlled; by default those of its
        declared loop, else the first input and the first sensor of speed.

    Returns
    -------
    Tuned
        ``controller``, ``summary()``; ``linear``, the start; ``stages`` with their errors [deg/s];
        ``gains`` and ``parts``, what the compensation takes off.

    Raises
    ------
    ValueError
        Aims that no PI keeps on this model; an input that does not drive the sensor.

    Examples
    --------
    >>> tuned = dm.tune_controller(dm.Model(), dm.Aims(gain_margin_db=8.0), plants=100)
    >>> print(tuned.summary())
    >>> tuned.controller.save("controller.toml")
    """
    if isinstance(model, RigModel):
        aims = aims or rig_aims(model, input, sensor)
        plant = linear_rig(level(model), input, sensor, aims.duty.sample_time)
    else:
        if input or sensor:
            raise ValueError("input and sensor are those of a rig; a Model has one loop")
        aims = aims or Aims()
        plant = linear_plant(level(model))
    start = fastest_pi(plant, **aims.linear())
    search = _Search(model, aims, plant, start, uncertainty, seed, jobs, (input, sensor))
    validation = draw_plants(model, plants, uncertainty=uncertainty, seed=seed + 1)
    stages: list[dict[str, Any]] = []
    errors = np.empty(0)
    for name, controller in search.stages():
        errors, volts = tracking(controller, validation, aims, seed=seed + 2, jobs=jobs)
        stages.append(
            {
                "stage": name,
                "rmse_median": float(np.median(errors)),
                "rmse_quantile": float(np.quantile(errors, QUANTILE)),
                "rmse_worst": float(errors.max()),
                "voltage_max": float(volts.max()),
                "controller": controller,
                "errors": errors,
            }
        )
    try:
        reference = linear_reference(plant, start)
    except ArithmeticError:
        reference = None
    best = stages[-1]["controller"]
    parts = predicted_parts(best, validation[:SEARCHED], aims, seed=seed + 2, jobs=jobs)
    return Tuned(best, start, reference, stages, errors, aims, parts)


def feed_forward_start(
    model: AnyModel, gains: PiTuning, aims: Aims, input: str = "", sensor: str = ""
) -> Controller:
    """Everything the model offers, at its natural values."""
    plant, dt = model.plant(), aims.duty.sample_time
    (source, *_), seen = loop_parts(model, input, sensor)
    late = 0.0 if plant.sensor_speed[seen] else DERIVATIVE * dt
    return Controller(
        kp=gains.kp,
        ki=gains.ki,
        limit=aims.limit,
        preload=smallest_preload(model, aims.duty) if isinstance(model, Model) else 0.0,
        sample_time=dt,
        inertia=1.0,
        friction=1.0,
        effects=1.0,
        lead=float(plant.input_values[source, 1]) + Parts(plant).lag(source, 0.0)[1] + 0.5 * dt,
        late=float(plant.sensor_delay[seen]) + late,
        acceleration=aims.acceleration,
        distance=START_DISTANCE * hidden_distance(model),
        invert=any(p.effect.site == "amplifier" and plant.on[p.flag] for p in plant.places),
        model=repeatable(model),
        input=input,
        sensor=sensor,
    )


def repeatable(model: AnyModel) -> Any:
    """The model without what depends on when a run started: no controller can know that.

    Of a rig without a position sensor also without what depends on an angle.
    """
    model = model.without([k for k, e in effects_of(model).items() if e.name == "base_vibration"])
    if isinstance(model, RigModel) and all(s.measures == "speed" for s in model.rig.sensors):
        kept, own = effects_of(level(model)), effects_of(model).items()
        model = model.without([k for k, e in own if e.site in AT_BODIES and k not in kept])
    return model


def to_be_homed(model: AnyModel) -> tuple[str, ...]:
    """Return the waves over an angle that no encoder with a lasting zero shows."""
    if not isinstance(model, RigModel) or any(s.absolute for s in model.rig.sensors):
        return ()
    kept, own = effects_of(level(model)), effects_of(repeatable(model)).items()
    acts: Any = {k: e for k, e in own if k not in kept and e.site in AT_BODIES}
    return tuple(k for k, e in acts.items() if e.effect.wave)


@dataclass
class _Search:
    model: AnyModel
    aims: Aims
    plant: Any
    start: PiTuning
    uncertainty: float
    seed: int
    jobs: int
    parts: tuple[str, str]  # input and sensor of a rig

    def stages(self) -> list[tuple[str, Controller]]:
        """Return name and controller of each stage."""
        forward = feed_forward_start(self.model, self.start, self.aims, *self.parts)
        two_motors = isinstance(self.model, Model)
        bare = Model() if two_motors else self.model.without(effects_of(self.model))
        plain = Controller(
            self.start.kp, self.start.ki, limit=self.aims.limit, model=bare,
            sample_time=self.aims.duty.sample_time, input=self.parts[0], sensor=self.parts[1],
        )  # fmt: skip
        pressed = replace(plain, preload=forward.preload)
        without = self.optimised(pressed)
        stages = [
            ("PI, linear design", plain),
            ("PI with preload", pressed),
            (WITHOUT, without),
            ("PI with feed-forward", replace(forward, preload=0.0)),
            ("both", forward),
            ("optimised", what_pays(self.optimised(forward), without, self.errors)),
        ]
        return [s for s in stages if two_motors or s[0] not in ("PI with preload", "both")]

    def optimised(self, begin: Controller) -> Controller:
        """Search a grid, which steps over cliffs of the cost, a notch, a distance; then refine."""
        sampled = SampledPlant(self.plant, begin.sample_time)
        grid = [
            replace(begin, kp=kp, ki=ki, preload=more * begin.preload)
            for kp, ki in _slower(sampled, self.start)
            for more in MORE_PRELOAD
        ]
        best, least = self.cheapest(grid)
        if self.aims.notch:
            best, least = self.cheapest(self.notched(best), best, least)
            hidden = hidden_distance(self.model)
            grid = [replace(best, distance=d * hidden) for d in DISTANCES]
            best, least = self.cheapest(grid, best, least)

        # of _STEPS, what does something
        own = [0] * (begin.friction > 0.0) + [1] * (begin.preload > 0.0)
        own += [2, 3] if begin.friction > 0.0 else []
        if not own:
            return best
        tick, hidden = begin.sample_time, hidden_distance(self.model)

        def near(moved: Floats) -> Controller:
            x = np.zeros(len(_STEPS))
            x[own] = moved
            return replace(
                best,
                friction=float(np.clip(best.friction + x[0], 0.0, 1.5)),
                preload=best.preload * float(np.clip(1.0 + x[1], 0.7, 1.4)),
                lead=max(best.lead + tick * x[2], 0.0),
                distance=max(best.distance + hidden * x[3], 0.0),
            )

        corners = np.vstack([np.zeros(len(own)), np.diag(np.array(_STEPS)[own])])
        found = minimize(
            lambda x: self.cost(near(x)),
            corners[0],
            method="Nelder-Mead",
            options={"initial_simplex": corners, "maxfev": _EVALUATIONS, "xatol": 1e-4},
        )
        return near(found.x) if found.fun < least else best

    def cheapest(
        self, grid: Sequence[Controller], best: Controller | None = None, least: float = np.inf
    ) -> tuple[Controller, float]:
        """Return the controller with the least cost, and that; the one known so far is one."""
        for tried in grid:
            cost = self.cost(tried)
            if best is None or cost < least:
                best, least = tried, cost
        assert best is not None
        return best, least

    def notched(self, begin: Controller) -> list[Controller]:
        """Controllers with a notch, if one lets the linear loop be faster."""
        dt = begin.sample_time
        found: Notched | None = notched_pi(self.plant, self.start, **self.aims.linear())
        if found is None:
            return []
        part = Notch(found.hz, found.depth, found.width)
        section = sampled_notch(part.hz, part.depth, part.width, dt)
        slow = _slower(SampledPlant(self.plant, dt, [section]), found.gains)
        return [replace(begin, kp=kp, ki=ki, notches=(part,)) for kp, ki in slow]

    @cached_property
    def drawn(self) -> list[AnyModel]:
        """The plants of the search."""
        return draw_plants(self.model, SEARCHED, uncertainty=self.uncertainty, seed=self.seed)

    def errors(self, tried: Controller) -> Floats:
        """Return the error on each of them [deg/s], (plants,)."""
        return tracking(tried, self.drawn, self.aims, seed=self.seed, jobs=self.jobs)[0]

    def cost(self, tried: Controller) -> float:
        """Return the error that most drawn plants stay below, and a price of hammering [deg/s]."""
        usual = float(np.quantile(self.errors(tried), QUANTILE))
        faster = replace(tried, kp=RESERVE * tried.kp, ki=RESERVE * tried.ki)
        return usual + max(float(self.errors(faster).max()) - TOLERATED * usual, 0.0)


def _slower(sampled: SampledPlant, gains: PiTuning) -> list[tuple[float, float]]:
    """Gains with crossovers from that of a design on down."""
    return [sampled.gains(gains.crossover_hz * s, gains.phase_margin_deg) for s in SLOWER]
