"""A model of a drive and what belongs to each log, as one point of a fit."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dmptm_ctrl.identify.free_parameters import ALL, Free
from dmptm_ctrl.identify.measured_motion import NONE, Nuisance
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import RigModel


@dataclass(frozen=True, eq=False)
class State:
    """A model and what belongs to each log."""

    model: RigModel
    logs: Mapping[str, Nuisance] = field(default_factory=dict)

    def nuisance(self, log: str) -> Nuisance:
        """What belongs to a log, and to all of them."""
        own, every = self.logs.get(log, NONE), self.logs.get(ALL, NONE)
        return replace(own, twist={**every.twist, **own.twist}) if every.twist else own

    def without(self, keys: Iterable[str]) -> "State":
        """Return the state without the effects of these keys."""
        return replace(self, model=self.model.without(keys))

    def get(self, free: Free) -> float:
        """Value of a number."""
        if free.kind == "value":
            return self.model.value(free.owner)
        if free.kind == "effect":
            return self.model.effect(free.owner).values.get(free.name, 0.0)
        return getattr(self.nuisance(free.owner), free.kind).get(free.name, 0.0)

    def room(self, frees: Sequence[Free]) -> tuple[Floats, Floats]:
        """How far numbers may move, down and up, in scales."""
        low = np.array([(f.low - self.get(f)) / f.scale for f in frees])
        return low, np.array([(f.high - self.get(f)) / f.scale for f in frees])

    def after(
        self, frees: Sequence[Free], step: Iterable[float], shrink: float = 1.0
    ) -> list[float]:
        """Values of numbers after a share of a step, in scales, inside their bounds."""
        return [
            float(np.clip(self.get(f) + shrink * f.scale * d, f.low, f.high))
            for f, d in zip(frees, step, strict=True)
        ]

    def moved(self, frees: Sequence[Free], values: Sequence[float]) -> "State":
        """Return the state with numbers replaced."""
        declared: dict[str, float] = {}
        placed = self.model.effects
        effects = {e.key: dict(e.values) for e in placed}
        zero = {k: dict(n.zero) for k, n in self.logs.items()}
        twist = {k: dict(n.twist) for k, n in self.logs.items()}
        for free, value in zip(frees, values, strict=True):
            if free.kind == "value":
                declared[free.owner] = float(value)
            elif free.kind == "effect":
                effects[free.owner][free.name] = float(value)
            else:
                into = zero if free.kind == "zero" else twist
                into.setdefault(free.owner, {})[free.name] = float(value)
        for effect in (e for e in placed if e.like):
            first, own = effects.get(effect.first, {}), PLACED_CATALOGUE[effect.name].own
            effects[effect.key] |= {k: v for k, v in first.items() if k not in own}
        model = replace(
            self.model,
            effects=tuple(e._replace(values=effects[e.key]) for e in placed),
            values={**self.model.values, **declared},
        )
        names = {*zero, *twist}
        return State(model, {k: Nuisance(zero.get(k, {}), twist.get(k, {})) for k in names})
