"""Residual of a rig file's balance, folded over what an effect depends on."""

from dataclasses import replace
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.candidate import members, name_of
from dmptm_ctrl.diagnosis.quality import Rows, fold
from dmptm_ctrl.diagnosis.rig_curves import Curve, variables_of
from dmptm_ctrl.diagnosis.rig_runs import variable_of
from dmptm_ctrl.diagnosis.rig_state import RigState
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.plots.diagnosis import Evidence
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.rig_model import Placed

MEASURES = {"theta": "position", "omega": "speed"}


def folded(
    without: RigState,
    final: RigState,
    variable: str,
    effect: str,
    unit: str,
    curve: Curve | None = None,
) -> Evidence:
    """Fold what the drive gave more than a model over a variable, on all logs.

    Over a turn or a period if a curve or a wave of the effect comes again by it, and by the way
    that the variable itself goes if the curve is a hysteresis. `without` is the model without the
    effect, the rest refitted; `variable` is as in `depends_on` of diagnosis.json, empty for the
    first position; `effect` is a key, empty where there is none; `unit` is that of the balance.
    """
    signals = variables_of(final.fit)
    speed = next(s for name, s in signals.items() if name.startswith("omega"))
    name = _measured(final, signals, variable)
    factor, label = _label(final.fit.model.rig, name)
    wave = _wave(final, effect, name)
    order = wave.values["order"] if wave else 0.0
    period = curve.period if curve else 2.0 * np.pi / order if order else 0.0
    by_itself = curve is not None and curve.kind == "hysteresis"
    if order not in (0.0, 1.0):
        label += ", over one wave"
    elif period:
        label += f", over {'a turn' if name != 'time' else f'a period of {period:.3g} s'}"

    def rows(state: RigState) -> list[Rows]:
        found = []
        share = float(final.fit.likelihood.independent[0])
        sides = (
            (state.fit.likelihood.balance, state.fit.left, final.fit.state),
            (state.held, state.held_left[0], final.held_state),
        )
        for balance, left, zeros in sides:
            for motion, part in zip(balance.motions, left, strict=True):
                use = motion.moving
                x, way = (motion.reduce(s(motion)) for s in (signals[name], speed))
                way = np.gradient(x) if by_itself else way
                if wave:  # encoders that start anywhere see it from zeros of their own
                    x = x + zeros.nuisance(motion.name).zero.get(wave.key, 0.0)
                x = x % period if period else x
                found.append((x[use] / factor, part[0][use], np.sign(way[use]), share))
        return found

    made = fold(rows(without), rows(final), label, f"drive − model\n[{unit}]", name_of(effect))
    return replace(made, ways=("rising", "falling")) if by_itself else made


def _wave(state: RigState, effect: str, name: str) -> Placed | None:
    """Return an effect at its first place if it comes again by a variable: its body's angle."""
    keys, model = members(effect), state.fit.model
    waves = (e for e in model.effects if e.key in keys and e.values.get("order"))
    return next((e for e in waves if variable_of(model, e.key) == name), None)


def _measured(state: RigState, signals: dict[str, Any], variable: str) -> str:
    """The variable among those that logs show, of a body that turns with the one meant."""
    if variable in signals:
        return variable
    kind, _, body = variable.partition(":")
    place = state.fit.model.layout.coordinate
    alike = [name for name in signals if name.partition(":")[0] == kind]
    tied = [n for n in alike if place.get(n.partition(":")[2]) == place.get(body, -1)]
    return next(iter([*tied, *alike, *signals]))


def _label(rig: Rig, name: str) -> tuple[float, str]:
    """SI per unit of a variable as the rig's sensors give it, and its label."""
    kind, _, of = name.partition(":")
    if kind in MEASURES:
        sensors = (s for s in rig.sensors if s.body == of and s.measures == MEASURES[kind])
        si = next((b.angle_unit for b in rig.bodies if b.name == of), "rad")
        unit = next((s.unit for s in sensors), si if kind == "theta" else f"{si}/s")
        return parse_unit(unit).factor, f"{MEASURES[kind]} of {of} [{unit}]"
    if kind in ("u", "du_dt"):
        source = next((i for i in rig.inputs if i.name == of), rig.inputs[0])
        rate = kind == "du_dt"
        label = f"{'rate of ' * rate}{source.name} [{source.unit}{'/s' * rate}]"
        return parse_unit(source.unit).factor, label
    return 1.0, f"{name.replace('_', ' ')} [s]"
