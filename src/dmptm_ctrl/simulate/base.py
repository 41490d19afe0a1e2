"""Numbers of a dual-motor drive as the loops take them, and what no drive may have."""

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.loading import LOADING

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model

_T = TypeVar("_T")
Floats = NDArray[np.float64]
Arrays = tuple[Floats, NDArray[np.uint8], Floats]  # base, on, values

BASE = (
    *("K_d", "K_M", "J_m", "J_2", "J_L", "N_1", "N_2", "z_3", "k_m", "k_a", "phi_r", "c", "c_f"),
    *("gap_l", "gap_r"),
    *("T3s_plus", "T3c_plus", "W3_plus", "B3_plus"),
    *("T3s_minus", "T3c_minus", "W3_minus", "B3_minus", "delta3"),
    *("TLs_plus", "TLc_plus", "WL_plus", "BL_plus"),
    *("TLs_minus", "TLc_minus", "WL_minus", "BL_minus", "deltaL"),
)


def refuse_negative(model: "Model") -> None:
    """Refuse effects whose size is negative where it is a magnitude, such as a stiffness.

    Raises
    ------
    ValueError
    """
    for name, values in model.effects.items():
        for parameter in CATALOGUE[name].parameters:
            value = values.get(parameter.name, 0.0)
            if parameter.low == 0.0 > value:
                raise ValueError(
                    f"effect {name}: {parameter.name} is {value:g}; it must be zero or more"
                )


def per_catalogue(function: Callable[..., _T]) -> Callable[..., _T]:
    """Keep what a function returns for as long as the catalogue has the same effects.

    A fit asks hundred thousands of times. The effects are told apart by identity, for to compare
    all their numbers takes longer than what is asked for. Threads that ask at once get one answer.
    """
    known: dict[tuple[int, ...], tuple[tuple[Effect, ...], _T]] = {}
    last: list[tuple[tuple[Effect, ...], _T]] = []

    def found() -> _T:
        effects = tuple(CATALOGUE.values())
        kept = next(iter(last), None)
        if kept is not None and kept[0] == effects:  # compares those first that are the same
            return kept[1]
        key = tuple(map(id, effects))
        with LOADING:
            if key not in known:
                # the effects too, or another may get an identity
                known[key] = effects, function(effects)
            last[:] = [known[key]]
        return known[key][1]

    return found


@per_catalogue
def layout(effects: tuple[Effect, ...]) -> dict[str, tuple[int, int]]:
    """Return, per effect, its index in `on` and its first slot in `values`."""
    ends = np.cumsum([len(effect.parameters) for effect in effects]).tolist()
    starts = [0, *ends[:-1]]
    return {e.name: (i, first) for i, (e, first) in enumerate(zip(effects, starts, strict=True))}
