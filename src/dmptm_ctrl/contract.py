"""What every effect file must offer. Knows no physics.

A *site* is the kind of place in the drive where an effect acts; it fixes the signature of the
kernel and how simulator, blocks and reference combine several effects. All kernels are pure
scalar functions, compiled by numba and callable from plain Python. They take their parameters
`p` as the NamedTuple of the effect. `side` is 0 for the left motor and pinion, 1 for the right, `body` is
0, 1 for the reducers and 2 for the ring gear. Units are SI and radians. The `age` of a body's
contact grows with time and falls with its slip; the simulation keeps it.

| site         | kernel                                              | returns                                    |
|--------------|-----------------------------------------------------|--------------------------------------------|
| amplifier    | (u, t, side, p)                                     | voltage after the effect [V]               |
| delay        | (side, p)                                           | dead time of the voltage [s]               |
| lag          | (u, side, p)                                        | (target [V], time constant [s])            |
| motor        | (u, theta_m, omega_m, t, side, p)                   | torque on the motor shaft [N·m]            |
| shaft        | (inertia, p)                                        | (compliance [rad/(N·m)], damping [N·m·s/rad]) at the pinion |
| mesh         | (theta_p, omega_p, theta_L, omega_L, side, p)       | (shift of z [rad], its rate, change of half-gap [rad], change of stiffness [N·m/rad]) |
| friction     | (theta, omega, t, mesh_torque, body, p)             | (factor on all friction, Coulomb torque added [N·m])     |
| presliding   | (body, p)                                         | (relaxation distance [rad], share of viscous friction that acts at once, damping ratio of the bristles) |
| dwell        | (age, body, p)                                      | (Coulomb torque added [N·m], slip that makes the contact new [rad]) |
| load         | (theta_L, omega_L, t, p)                            | torque on the ring gear [N·m]              |
| sensor       | (theta_L, omega_L, t, p)                            | (angle reading [rad], speed reading [rad/s]) |
| sensor_delay | (p)                                             | dead time of the speed reading [s]         |
"""

from collections import namedtuple
from collections.abc import Callable
from typing import Any, NamedTuple

SITES = (
    *("amplifier", "delay", "lag", "motor", "shaft", "mesh", "friction", "presliding", "dwell"),
    *("load", "sensor", "sensor_delay"),
)
# what shows an effect
BALANCE, MOTOR_ENCODERS, SENSORS, RUNS = "balance", "motor encoders", "sensors", "runs"


class Parameter(NamedTuple):
    """One number of an effect.

    Attributes
    ----------
    name, unit : str
        SI unit, radians.
    low, high : float
        Bounds of what is plausible on a drive of this kind.
    step : float
        A clearly visible size: the difference step of sensitivities and the
        scale of searches.
    bank : tuple of float
        Values to try for a parameter without meaning at zero effect (order,
        place, time constant); empty for an amplitude.
    fixed : bool
        Whether a fit leaves it at a value of its bank, such as a whole number.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float
    bank: tuple[float, ...] = ()
    fixed: bool = False


def cosine_and_sine(
    unit: str, largest: float, step: float, prefixes: tuple[str, ...] = ("",)
) -> tuple[Parameter, ...]:
    """Return the amplitudes of a wave, of either sign; of one per prefix of their names."""
    names = (f"{prefix}{part}" for prefix in prefixes for part in ("cosine", "sine"))
    return tuple(Parameter(name, unit, -largest, largest, step) for name in names)


SIDES = ("left_", "right_")  # prefixes of what each motor or pinion has of its own


class _Declared(NamedTuple):
    """What a file says of an effect."""

    name: str
    site: str
    kernel: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    location: str
    source: str
    depends_on: tuple[str, ...]
    reveals: str
    seen_by: str = BALANCE
    starts: tuple[tuple[str, float], ...] = ()
    search: str = ""
    constants: tuple[str, ...] = ()
    wave: bool = False
    fast: bool = False
    kink: float = 0.0
    ringing: tuple[str, ...] = ()
    matters: float = 0.0
    values: type[Any] | None = None


class Effect(_Declared):
    """A physical effect: its kernel, its parameters and what is known of it.

    The effect is absent exactly when all its amplitudes are zero.

    Attributes
    ----------
    name, site, kernel, parameters
        What it is.
    location, source, depends_on, reveals
        Where it acts, by which source, on which variables, and the experiment that shows it.
    seen_by : str
        What shows it: a balance of torques, encoders at the motors, two sensors of one motion, or
        runs alone, as it acts near rest, where balances do not look.
    starts : tuple of (parameter, multiple of its `step`)
        Where fits begin of what has no slope at zero, or is far from linear.
    search : str
        How its shape is found: "orders", "frequencies", "places", "limits"; else by its bank.
    constants : tuple of str
        Amplitudes that alone make another effect, such as the constant torque of a spring.
    wave : bool
        Whether its amplitudes are a cosine and a sine of an angle.
    fast : bool
        Whether it acts faster than a window of a balance passes.
    kink : float
        Difference step of its parameters, in scales, that passes a few kinks; 0: it has none.
    ringing : tuple of str
        Parameters of what is over before a window is; runs alone show them.
    matters : float
        Size from which it matters, of an error of a sensor.
    values : NamedTuple class
        Holds the parameters as the kernel takes them; made of their names where none is given.
    """

    values: type[Any]

    def __new__(cls, *args: Any, **fields: Any) -> "Effect":
        """Make it, with a class for its parameters."""
        made = super().__new__(cls, *args, **fields)
        names = [p.name for p in made.parameters]
        return made if made.values else made._replace(values=namedtuple(made.name, names))

    def __str__(self) -> str:
        """Return its name, its place, and a line per parameter: unit and bounds, in SI."""
        wide = max((len(p.name) for p in self.parameters), default=0)
        lines = [
            f"  {p.name:{wide}}  {p.low:g} to {p.high:g} {p.unit}".rstrip() for p in self.parameters
        ]
        return "\n".join([f"{self.name} @ {self.location}", *lines])

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the parameters that are zero when the effect is absent."""
        return tuple(p.name for p in self.parameters if not p.bank)

    @property
    def shapes(self) -> tuple[str, ...]:
        """Names of the parameters that have no meaning at zero effect."""
        return tuple(p.name for p in self.parameters if p.bank)

    def defaults(self) -> tuple[float, ...]:
        """Return the parameters of the absent effect: zero amplitudes, mid-bank shapes."""
        return tuple(self.absent().values())

    def absent(self) -> dict[str, float]:
        """Return the same by name."""
        return {p.name: p.bank[len(p.bank) // 2] if p.bank else 0.0 for p in self.parameters}
