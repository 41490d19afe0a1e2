"""The linear plant that a design starts from."""

from typing import Any

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.linear import linearize, turning
from dmptm_ctrl.simulate.model import Model

PRELOADS = (0.3, 0.5, 0.8, 1.2)  # V; the least of them that keeps the meshes closed


def linear_plant(model: Model, **turn: float) -> Any:
    """Linearise a model about a steady turn, the slowest usual one, under the least preload."""
    problem: ValueError | None = None
    for preload in PRELOADS:
        try:
            return linearize(model, *turning(model, preload=preload, **turn))
        except ValueError as error:
            problem = error
    raise problem or ValueError("no steady turn")


def level(model: Model) -> Model:
    """The model without what depends on an angle.

    Linearised at one place such torques are a spring, or push away: no plant whose speed an
    integrator can hold. Over a turn they are a disturbance.
    """
    by_angle = [n for n in model.effects if any("theta" in x for x in CATALOGUE[n].depends_on)]
    return model.without(by_angle)
