"""A drive with effects added to it: what is simulated, fitted, saved and turned into blocks."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compose import layout, per_catalogue

if TYPE_CHECKING:
    import control

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
LOG_LENGTH = "log_length"  # parameter of an effect: of the log that is simulated


@per_catalogue
def _neutral(effects: tuple[Effect, ...]) -> Floats:
    """Parameters of all effects at which they are absent."""
    return np.array([v for effect in effects for v in effect.defaults()])


@dataclass(frozen=True, eq=False)
class Stacked(Sequence[Arrays]):
    """What :meth:`Model.arrays` gives of many drives, in rows, as the loops take it.

    Attributes
    ----------
    base, on, values : (drives, ...) arrays
    """

    base: Floats
    on: NDArray[np.uint8]
    values: Floats

    def __len__(self) -> int:
        return len(self.base)

    @overload
    def __getitem__(self, k: int) -> Arrays: ...
    @overload
    def __getitem__(self, k: slice | NDArray[np.intp]) -> "Stacked": ...
    def __getitem__(self, k: int | slice | NDArray[np.intp]) -> "Arrays | Stacked":
        rows = self.base[k], self.on[k], self.values[k]
        return Stacked(*rows) if isinstance(k, slice | np.ndarray) else rows


def stacked(arrays: Sequence[Arrays]) -> Stacked:
    """Stack the numbers of many drives, if they are not."""
    if isinstance(arrays, Stacked):
        return arrays
    return Stacked(*(np.array(rows) for rows in zip(*arrays, strict=True)))


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

    def to_blocks(self, **options: Any) -> "control.InterconnectedSystem":
        """Return the model as python-control blocks, see :func:`.blocks.to_blocks`."""
        from dmptm_ctrl.simulate.blocks import to_blocks

        return to_blocks(self, **options)
