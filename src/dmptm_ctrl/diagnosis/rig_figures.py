"""Residual of a rig file's balance, folded over what an effect depends on."""

from collections.abc import Sequence
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
    waves = [e for e in final.fit.model.effects if e.key in members(effect) and _turns(e)]
    period = curve.period if curve else _period(final, waves, name)
    by_itself = curve is not None and curve.kind == "hysteresis"
    if period and waves and _turns(waves[0]) != 1.0:
        label += ", over one wave"
    elif period:
        label += f", over {'a turn' if name != 'time' else f'a period of {period:.3g} s'}"

    def rows(state: RigState) -> list[Rows]:
        found = []
        news = float(final.fit.likelihood.news[0])
        sides = (
            (state.fit.likelihood.balance, state.fit.left, final.fit.state),
            (state.held, state.held_left[0], final.held_state),
        )
        for balance, left, zeros in sides:
            for motion, part in zip(balance.motions, left, strict=True):
                use = motion.moving
                x, way = (motion.reduce(s(motion)) for s in (signals[name], speed))
                way = np.gradient(x) if by_itself else way
                if period and waves:  # encoders that start anywhere see it from zeros of their own
                    x = x + zeros.nuisance(motion.name).zero.get(waves[0].key, 0.0)
                x = x % period if period else x
                found.append((x[use] / factor, part[0][use], np.sign(way[use]), news))
        return found

    made = fold(rows(without), rows(final), label, f"drive − model\n[{unit}]", name_of(effect))
    return replace(made, ways=("rising", "falling")) if by_itself else made


def _turns(effect: Placed) -> float:
    """Waves of an effect per turn of its body; 0 where it has none."""
    return effect.values.get("order", 0.0)


def _period(state: RigState, waves: Sequence[Placed], name: str) -> float:
    """Angle of a variable's body after which a wave comes again; 0 if it is no angle of it."""
    if not waves or name != variable_of(state.fit.model, waves[0].key):
        return 0.0
    return 2.0 * np.pi / _turns(waves[0])


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
