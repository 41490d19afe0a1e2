"""What a controller takes from its model, part by part, and what each part gains."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from dmptm_ctrl.design.aims import Aims, tracking
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.simulate.any_model import AnyModel, effects_of
from dmptm_ctrl.simulate.model import Floats

QUANTILE = 0.9
# parts of a compensation besides effects -> fields that switch them off
_PARTS: dict[str, dict[str, Any]] = {
    "inertia": {"inertia": 0.0},
    "friction": {"friction": 0.0},
    "look-ahead": {"lead": 0.0, "late": 0.0},
    "inverse of the drive": {"invert": False},
}


def parts_of(controller: Controller) -> list[str]:
    """Return the parts of a controller's compensation that can be left out."""
    on = [
        name
        for name, off in _PARTS.items()
        if any(getattr(controller, key) != value for key, value in off.items())
    ]
    return [*on, *effects_of(controller.model)]


def without_part(controller: Controller, part: str) -> Controller:
    """Return the controller without one part of its compensation."""
    if part in _PARTS:
        return replace(controller, **_PARTS[part])
    return replace(controller, model=controller.model.without([part]))


def predicted_parts(
    controller: Controller, plants: Sequence[AnyModel], aims: Aims, *, seed: int, jobs: int
) -> pd.DataFrame:
    """Return what each part of a compensation takes off the error, most first.

    A part without which nothing changes is left out. Columns are ``median`` and ``sure``, as in
    the result of tuning.
    """
    errors, _ = tracking(controller, plants, aims, seed=seed, jobs=jobs)
    found = {}
    for part in parts_of(controller):
        left = without_part(controller, part)
        shares = 1.0 - errors / tracking(left, plants, aims, seed=seed, jobs=jobs)[0]
        if np.any(shares):
            found[part] = np.quantile(shares, [0.5, 1.0 - QUANTILE])
    table = pd.DataFrame.from_dict(found, "index", columns=["median", "sure"], dtype=float)
    return table.sort_values("median", ascending=False)


def what_pays(
    found: Controller, without: Controller, errors: Callable[[Controller], Floats]
) -> Controller:
    """Leave out of a compensation what does harm; all of it if the whole does not surely pay.

    Harm is a larger error, of that which nine of ten plants stay below; surely is on nine of ten.
    A part that changes nothing here stays: it is for motions that are not tried. `found` is with
    all of the compensation, `without` was tuned without any; `errors` gives the tracking errors
    of a controller on drawn plants, the same ones each time.
    """
    least = errors(found)
    for part in parts_of(found):
        left = without_part(found, part)
        now = errors(left)
        if np.quantile(now, QUANTILE) < np.quantile(least, QUANTILE):
            found, least = left, now
    pays = np.quantile(1.0 - least / errors(without), 1.0 - QUANTILE) > 0.0
    return found if pays else without
