"""The paper's drive as data: Tables 1 and 2 with unit, tolerance and source.

Errata of the printed tables are put right by default; ``paper_drive(as_printed=True)``
gives the printed values. Each correction is named in :mod:`dmptm_ctrl.drive.errata`.

Source: Zheng et al. 2022, doi:10.21203/rs.3.rs-1546754/v1 ("the paper").
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite, pi
from types import MappingProxyType
from typing import SupportsFloat

ARCMIN = pi / (180 * 60)  # rad
DEG = pi / 180  # rad


def physical(what: str, value: float, unit: str = "", *, zero: bool = False) -> None:
    """Refuse, as a ValueError that names `what`, a number that no machine has.

    It is negative, not finite, or zero where it may not be `zero`.
    """
    if not (0.0 <= value < inf if zero else 0.0 < value < inf):
        wanted = "zero or more" if zero else "more than zero"
        raise ValueError(f"{what} is {value:g}{unit and ' '}{unit}, it must be {wanted} and finite")


def positive(**values: float) -> None:
    """Refuse arguments that are not positive and finite, by their names, as a ValueError."""
    for name, value in values.items():
        physical(name, value)


@dataclass(frozen=True)
class Quantity:
    """A declared number: value, unit, how far the truth may be from it, and who says so."""

    value: float  # in `unit`, which is of the SI
    unit: str
    tolerance: float  # relative half-width of the declared range; 0 is exact
    source: str
    low: float | None = None  # absolute range, in place of a relative tolerance
    high: float | None = None

    def __str__(self) -> str:
        if not isfinite(self.value):
            return "unknown"
        text = f"{self.value:.4g} {self.unit}".strip()
        if self.low is not None and self.high is not None:
            return f"{text} ({self.low:.4g} to {self.high:.4g})"
        return f"{text} ± {100 * self.tolerance:.3g} %" if self.tolerance else text

    @property
    def range(self) -> tuple[float, float]:
        """Declared range (low, high)."""
        if self.low is not None and self.high is not None:
            return self.low, self.high
        half = abs(self.value) * self.tolerance
        return self.value - half, self.value + half

    @property
    def is_free(self) -> bool:
        """Whether the declaration leaves the value open."""
        low, high = self.range
        return high > low


@dataclass(frozen=True, repr=False)
class Drive(Mapping[str, float]):
    """Declared parameters of a dual-motor drive; a read-only mapping name → value.

    ``print(drive)`` lists them. `drive["k_m"]` is a value in SI, `drive.quantities["k_m"]` the
    value with unit, range and source.

    Attributes
    ----------
    quantities : mapping of str to Quantity
        ``K_d`` amplifier, ``K_M`` torque constant; inertias ``J_m`` of a motor, ``J_2`` beside it
        at the pinion, ``J_L`` of the ring gear; ``N_1`` motor turns per pinion turn, ``N_2``
        pinion turns per turn of the ring gear; ``k_m``, ``c``, ``c_f`` stiffness of a mesh, its
        damping in contact and in the gap; ``gap_l``, ``gap_r`` half-gaps. Friction of a pinion
        (3) and of the ring gear (L), by direction: ``T3s`` static, ``T3c`` Coulomb, ``W3``
        Stribeck speed, ``B3`` viscous.
    name : str

    Examples
    --------
    >>> heavier = dm.paper_drive().with_values(J_L=3.0)
    >>> heavier["J_L"]
    3.0
    """

    quantities: Mapping[str, Quantity]
    name: str = "drive"

    def __post_init__(self) -> None:
        object.__setattr__(self, "quantities", MappingProxyType(dict(self.quantities)))

    def __repr__(self) -> str:
        return f"<Drive {self.name!r}: {len(self)} parameters>"

    def __str__(self) -> str:
        rows = [f"{key:10} {q!s:32} {q.source}" for key, q in self.quantities.items()]
        return "\n".join([f"drive: {self.name}", *rows])

    def __getitem__(self, key: str) -> float:
        try:
            return self.quantities[key].value
        except KeyError:
            known = ", ".join(self.quantities)
            raise KeyError(f"no parameter {key!r} in {self.name}; it has {known}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.quantities)

    def __len__(self) -> int:
        return len(self.quantities)

    def __hash__(self) -> int:
        return hash((self.name, tuple(self.values())))

    def __reduce__(self) -> tuple[type, tuple[dict[str, Quantity], str]]:
        return Drive, (dict(self.quantities), self.name)

    def with_values(self, **values: float) -> "Drive":
        """Return the same drive with some values replaced; declarations stay.

        Raises
        ------
        KeyError
            A name that the drive does not have.
        TypeError
            A value that is no number.
        """
        new = dict(self.quantities)
        for key, value in values.items():
            self[key]
            if not isinstance(value, float | SupportsFloat):  # the first is the quicker one
                raise TypeError(f"{key} is {value!r}; it must be a number")
            new[key] = replace(new[key], value=float(value))
        return Drive(new, self.name)

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters whose declaration is a range."""
        return tuple(k for k, q in self.quantities.items() if q.is_free)

    def check(self) -> None:
        """Refuse values that no drive has.

        Raises
        ------
        ValueError
            A number that is not finite; an inertia, stiffness, ratio or gain that is not
            positive. J_2, what the pinion side adds to N1² J_m, may be zero.
        """
        for name, quantity in self.quantities.items():
            if name in _POSITIVE:
                physical(f"{self.name}: {name}", quantity.value, quantity.unit, zero=name == "J_2")
            elif not isfinite(quantity.value):
                raise ValueError(f"{self.name}: {name} is {quantity.value}; it must be finite")


_POSITIVE = ("K_d", "K_M", "J_m", "J_2", "J_L", "N_1", "N_2", "k_m")
_FRICTION_TOL = 0.12  # declared spread of friction and gaps from rig to rig
# No theory gives the exponent: 1/2 to 1 (Bo, Pavelescu), 2 (Armstrong-Hélouvry), in Automatica 30
# (1994) 1083.
_EXPONENT_TOL = 0.5
_INERTIA_TOL = 0.06
_STIFFNESS_TOL = 0.10


def _friction(
    body: str, label: str, plus: tuple[float, ...], minus: tuple[float, ...]
) -> dict[str, Quantity]:
    """Return one row of Table 2 in SI; magnitudes, the sign is that of the speed."""
    rows: dict[str, Quantity] = {}
    for sign, (static, coulomb, stribeck, viscous) in (("plus", plus), ("minus", minus)):
        source = f"Table 2, {label}"
        rows[f"T{body}s_{sign}"] = Quantity(static, "N·m", _FRICTION_TOL, source)
        rows[f"T{body}c_{sign}"] = Quantity(coulomb, "N·m", _FRICTION_TOL, source)
        rows[f"W{body}_{sign}"] = Quantity(stribeck * DEG, "rad/s", _FRICTION_TOL, source)
        rows[f"B{body}_{sign}"] = Quantity(viscous / DEG, "N·m·s/rad", _FRICTION_TOL, source)
    rows[f"delta{body}"] = Quantity(1.0, "", _EXPONENT_TOL, f"Table 2, {label}")
    return rows


def paper_drive(*, as_printed: bool = False) -> Drive:
    """Return the parameters of the paper's dual-motor drive.

    Parameters
    ----------
    as_printed : bool
        Give the tables as printed, errata included, without tolerances on c.

    Returns
    -------
    Drive
        SI units. `gap_l`, `gap_r` are half-gaps at the pinion. `T3…` act on the pinion
        side of both reducers, `TL…` on the ring gear.

    Notes
    -----
    Tables 1 and 2; corrections in docs/errata.md. `c_f` is "an adjustable parameter" (section
    4.2.2) without a printed value: ours, a small fraction of c.

    Examples
    --------
    >>> drive = dm.paper_drive()
    >>> drive["J_L"], drive.quantities["J_L"].unit
    (2.5, 'kg·m²')
    """
    t1 = "Table 1"
    reducer_plus = (2.5, 2.8, 2.0, 0.01) if as_printed else (2.8, 2.5, 2.0, 0.01)
    q = {
        "K_d": Quantity(3.0, "A/V", 0.0, t1),
        "K_M": Quantity(0.13, "N·m/A", 0.0, t1),
        "J_m": Quantity(2e-4, "kg·m²", _INERTIA_TOL, t1),
        "J_2": Quantity(0.125, "kg·m²", _INERTIA_TOL, t1 + ", see docs/errata.md"),
        "J_L": Quantity(2.5, "kg·m²", _INERTIA_TOL, t1),
        "N_1": Quantity(25.0, "", 0.0, t1),
        "N_2": Quantity(8.25, "", 0.0, t1),
        "z_3": Quantity(20.0, "", 0.0, t1),
        "k_m": Quantity(3.6e4, "N·m/rad", _STIFFNESS_TOL, t1),
        "k_a": Quantity(0.0, "N·m/rad", 0.0, "not printed"),
        "phi_r": Quantity(0.0, "rad", 0.0, "below Eq. 23"),
        "c": Quantity(1.0, "N·m·s/rad", 0.0, t1)
        if as_printed
        else Quantity(
            3.0, "N·m·s/rad", 0.0, t1 + " prints 1, see docs/errata.md", low=1.0, high=10.0
        ),
        "c_f": Quantity(0.05, "N·m·s/rad", 0.0, "ours", low=0.0, high=0.5),
        "gap_l": Quantity(14 * ARCMIN, "rad", _FRICTION_TOL, t1),
        "gap_r": Quantity(10 * ARCMIN, "rad", _FRICTION_TOL, t1),
        **_friction("3", "pinion with reducer", reducer_plus, (2.0, 1.8, 2.0, 0.008)),
        **_friction("L", "ring gear", (23.0, 20.0, 1.0, 1.2), (20.0, 17.0, 1.0, 1.0)),
    }
    for name in () if as_printed else ("T3s_plus", "T3c_plus"):
        q[name] = replace(q[name], source="Table 2 has the two swapped, see docs/errata.md")
    return Drive(q, "paper as printed" if as_printed else "paper")


def viscous_mean(drive: Drive, body: str) -> float:
    """Return the viscous friction of "3" or "L" [N·m·s/rad], mean of both directions of Table 2.

    The slope of Stribeck friction far above its Stribeck speed: the linear model's D3, DL.
    """
    return 0.5 * (drive[f"B{body}_plus"] + drive[f"B{body}_minus"])


def pinion_inertia(drive: Drive) -> float:
    """Return J̄3 [kg·m²] at the pinion: N1² Jm and what Table 1's J2 adds beside it."""
    return drive["N_1"] ** 2 * drive["J_m"] + drive["J_2"]
