"""A drive with effects added to it: what is simulated, fitted, saved and turned into blocks."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from math import isnan
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.loading import LOADING

if TYPE_CHECKING:
    import control

_T = TypeVar("_T")
LOG_LENGTH = "log_length"  # parameter of an effect: of the log that is simulated
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


@per_catalogue
def _neutral(effects: tuple[Effect, ...]) -> Floats:
    """Parameters of all effects at which they are absent."""
    return np.array([v for effect in effects for v in effect.defaults()])


@dataclass(frozen=True)
class Model:
    """A declared drive and the effects added to it.

    Attributes
    ----------
    drive : Drive
    effects : mapping
        Effect name → {parameter name: value}; parameters left out take the value of the
        absent effect.

    Raises
    ------
    KeyError
        An effect that is not in the catalogue, or a parameter that it does not have.
    ValueError
        A value that no drive has, see :meth:`~dmptm_ctrl.drive.Drive.check`, or that is NaN.
    """

    drive: Drive = field(default_factory=paper_drive)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.drive.check()
        for name, parameters in self.effects.items():
            if name not in CATALOGUE:
                known = ", ".join(CATALOGUE)
                raise KeyError(f"no effect {name!r} in the catalogue; it has {known}")
            has = [p.name for p in CATALOGUE[name].parameters]
            for key in parameters:
                if key not in has:
                    raise KeyError(f"effect {name!r} has no parameter {key!r}; it has {has}")
                if isnan(parameters[key]):
                    raise ValueError(f"effect {name}: {key} is NaN; it must be a number")

    def with_effect(self, name: str, **parameters: float) -> "Model":
        """Return the model with an effect added or replaced."""
        return Model(self.drive, {**self.effects, name: parameters})

    def without(self, names: Iterable[str]) -> "Model":
        """Return the model without the named effects."""
        gone = set(names)
        return Model(self.drive, {k: v for k, v in self.effects.items() if k not in gone})

    def with_values(self, **values: float) -> "Model":
        """Return the model with parameters of the drive replaced."""
        return Model(self.drive.with_values(**values), self.effects)

    def over(self, seconds: float) -> "Model":
        """Return the model for a log of a length [s], where an effect depends on it."""
        told = {
            name: {**values, LOG_LENGTH: seconds}
            for name, values in self.effects.items()
            if LOG_LENGTH in CATALOGUE[name].shapes
        }
        return Model(self.drive, {**self.effects, **told}) if told else self

    def arrays(self) -> tuple[Floats, NDArray[np.uint8], Floats]:
        """Return (base, on, values) as the compiled loop takes them."""
        quantities = self.drive.quantities
        base = np.array([quantities[name].value for name in BASE])
        values = _neutral().copy()
        on = np.zeros(len(CATALOGUE), np.uint8)
        if self.effects:
            slots = layout()
        for name, parameters in self.effects.items():
            index, first = slots[name]
            effect = CATALOGUE[name]
            for j, p in enumerate(effect.parameters):
                if p.name in parameters:
                    values[first + j] = parameters[p.name]
            on[index] = any(parameters.get(a, 0.0) != 0.0 for a in effect.amplitudes)
        return base, on, values

    @property
    def sites(self) -> set[str]:
        """Sites at which an effect acts."""
        _, on, _ = self.arrays()
        return {e.site for e, acts in zip(CATALOGUE.values(), on, strict=True) if acts}

    def to_blocks(self, **options: Any) -> "control.InterconnectedSystem":
        """Return the model as python-control blocks, see :func:`.blocks.to_blocks`."""
        from dmptm_ctrl.simulate.blocks import to_blocks

        return to_blocks(self, **options)
