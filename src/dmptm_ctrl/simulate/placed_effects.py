"""Effects that a drive of any shape can have, and how each kernel is placed there.

The kernels are those of `effects/`; this says what they act on (a body, a link, an input, a
sensor) and which of their parameters a single such place has. A user's own effect registers
with :func:`register`.
"""

from math import inf
from typing import NamedTuple

from dmptm_ctrl.contract import Effect, Parameter
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.effects import backlash
from dmptm_ctrl.effects.base_vibration import BASE_VIBRATION
from dmptm_ctrl.effects.cable_spring import CABLE_SPRING
from dmptm_ctrl.effects.cogging import COGGING
from dmptm_ctrl.effects.coulomb_friction import COULOMB_FRICTION
from dmptm_ctrl.effects.current_lag import CURRENT_LAG
from dmptm_ctrl.effects.drive_dead_band import DRIVE_DEAD_BAND
from dmptm_ctrl.effects.drive_delay import DRIVE_DELAY
from dmptm_ctrl.effects.drive_offset import DRIVE_OFFSET
from dmptm_ctrl.effects.drive_saturation import DRIVE_SATURATION
from dmptm_ctrl.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from dmptm_ctrl.effects.friction_asymmetry import FRICTION_ASYMMETRY
from dmptm_ctrl.effects.load_dependent_friction import (
    LOAD_DEPENDENT_FRICTION,
    body_load_friction,
)
from dmptm_ctrl.effects.local_spot import LOCAL_SPOT
from dmptm_ctrl.effects.position_dependent_friction import POSITION_DEPENDENT_FRICTION
from dmptm_ctrl.effects.presliding import PRESLIDING
from dmptm_ctrl.effects.quadratic_drag import QUADRATIC_DRAG
from dmptm_ctrl.effects.sensor_delay import SENSOR_DELAY
from dmptm_ctrl.effects.sensor_gain import SENSOR_GAIN
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.effects.stribeck_friction import STRIBECK_FRICTION
from dmptm_ctrl.effects.thermal_drift import THERMAL_DRIFT
from dmptm_ctrl.effects.unbalance import UNBALANCE
from dmptm_ctrl.effects.viscous_friction import VISCOUS_FRICTION

# site of the contract -> where it acts
SITES = {
    "drive": "input",
    "delay": "input",
    "lag": "input",
    "motor": "body",
    "load": "body",
    "friction": "body",
    "ageing": "body",
    "presliding": "body",
    "shaft": "body",
    "mesh": "link",
    "gap": "link",
    "sensor": "sensor",
    "sensor_delay": "sensor",
}
RING = 2  # `body` of kernels that act on the ring gear alone

BACKLASH = Effect(
    name="backlash",
    site="gap",
    kernel=backlash.mesh_torque,
    parameters=(Parameter("half_gap", "rad", 0.0, 0.1, 1e-3),),
    values=backlash.Backlash,
    location="mesh",
    source="paper Eq. 21",
    depends_on=("mesh_torque",),
    reveals="reversals with small torque, with encoders on both sides of the gap",
    kink=0.005,
)


# What would show an effect on a drive of any shape.
REVEALS = {
    "viscous_friction": "steady motion at several speeds",
    "coulomb_friction": "motion in both directions at several speeds",
    "friction_asymmetry": "motion in both directions at several speeds; only these tell it from "
    "an offset of the drive",
    "stribeck_friction": "slow reversals, and steady motion from very slow to fast",
    "presliding": "torque below breakaway, with an encoder that resolves the creep",
    "load_dependent_friction": "the same motion under different loads or preloads",
    "position_dependent_friction": "slow motion over the whole travel, both ways",
    "local_spot": "slow motion over the whole travel, both ways, several times",
    "thermal_drift": "the same motion early and late in a long log from cold",
    "quadratic_drag": "steady motion from slow to the highest speed",
    "unbalance": "slow motion over a whole turn, both ways",
    "cable_spring": "slow motion over the whole travel, both ways, with stops",
    "base_vibration": "a log at rest, and motion at several speeds",
    "cogging": "slow steady motion over several periods of it, at two speeds",
    "drive_offset": "motion in both directions at several speeds",
    "drive_dead_band": "small slow signals around zero, besides large ones",
    "drive_saturation": "signals well below and well above the limit",
    "drive_delay": "fast changes of the signal (multisine, chirp, square)",
    "current_lag": "fast changes of the signal (multisine, chirp)",
    "shaft_compliance": "a chirp or multisine past the resonance, at best with sensors on both "
    "sides",
    "backlash": "reversals with small torque, at best with encoders on both sides of the gap",
    "sensor_delay": "position and speed of the same body, with fast changes",
    "sensor_gain": "position and speed of the same body",
    "encoder_eccentricity": "position and speed of the same body over whole turns",
}


class PlacedEffect(NamedTuple):
    """An effect as one place of a drive has it.

    Attributes
    ----------
    effect : Effect
        Owner of the kernel.
    keep : tuple of str
        Parameters that one place has, in its own naming.
    fields : tuple of int or float
        For each field of the kernel's parameters: which of `keep`, or a constant.
    told : int
        Side or body that the kernel is told.
    """

    effect: Effect
    keep: tuple[Parameter, ...]
    fields: tuple[int | float, ...]
    told: int = RING

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def site(self) -> str:
        """Site of the effect."""
        return self.effect.site

    @property
    def reveals(self) -> str:
        """Experiment that would show it."""
        return REVEALS.get(self.name, self.effect.reveals)

    @property
    def place(self) -> str:
        """What it acts on: body, link, input or sensor."""
        return SITES[self.effect.site]

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the parameters that are zero when the effect is absent."""
        return tuple(p.name for p in self.keep if not p.bank)

    @property
    def defaults(self) -> tuple[float, ...]:
        """Parameters at which the effect is absent: zero amplitudes, mid-bank shapes."""
        return tuple(p.bank[len(p.bank) // 2] if p.bank else 0.0 for p in self.keep)

    @property
    def shapes(self) -> tuple[str, ...]:
        """Names of the parameters without meaning at zero effect."""
        return tuple(p.name for p in self.keep if p.bank)


def may_stand(chain: PlacedEffect, rig: Rig, part: str) -> bool:
    """Whether an effect can do anything at a part of its kind: what links carry needs a link."""
    if chain.place != "body" or "mesh_torque" not in chain.effect.depends_on:
        return True
    return any(part in (link.first, link.second) and not link.rigid for link in rig.links)


def whole(effect: Effect) -> PlacedEffect:
    """Return an effect whose parameters belong to one place as they are."""
    told = RING if effect.site in ("friction", "presliding", "ageing") else 0
    if effect is LOAD_DEPENDENT_FRICTION:
        told = 0  # its kernel acts on reducers
    return PlacedEffect(effect, effect.parameters, tuple(range(len(effect.parameters))), told)


def _one_side(effect: Effect, names: dict[str, str]) -> PlacedEffect:
    """Return an effect with parameters per side, reduced to one side.

    `names` maps the kernel's parameters to the chain's; the others are zero.
    """
    keep = [p._replace(name=names[p.name]) for p in effect.parameters if p.name in names]
    fields: list[int | float] = []
    for parameter in effect.parameters:
        fields.append(
            [k.name for k in keep].index(names[parameter.name]) if parameter.name in names else 0.0
        )
    return PlacedEffect(effect, tuple(keep), tuple(fields), RING if effect is PRESLIDING else 0)


PLACED_CATALOGUE: dict[str, PlacedEffect] = {
    chain.name: chain
    for chain in (
        whole(VISCOUS_FRICTION),
        whole(COULOMB_FRICTION),
        whole(FRICTION_ASYMMETRY),
        whole(STRIBECK_FRICTION),
        _one_side(PRESLIDING, {"ring_distance": "distance"}),
        whole(LOAD_DEPENDENT_FRICTION._replace(kernel=body_load_friction)),
        whole(POSITION_DEPENDENT_FRICTION),
        whole(LOCAL_SPOT),
        # the ring gear's own terms need the length of a log
        PlacedEffect(
            THERMAL_DRIFT,
            tuple(p for p in THERMAL_DRIFT.parameters if p.name in ("rise", "time_constant")),
            (0, 0.0, 0.0, 1, 1.0),
            0,
        ),
        whole(QUADRATIC_DRAG),
        whole(UNBALANCE),
        whole(CABLE_SPRING),
        whole(BASE_VIBRATION),
        _one_side(COGGING, {"left_cosine": "cosine", "left_sine": "sine", "order": "order"}),
        _one_side(DRIVE_OFFSET, {"left": "offset"}),
        whole(DRIVE_DEAD_BAND),
        whole(DRIVE_SATURATION),
        whole(CURRENT_LAG),
        whole(DRIVE_DELAY),
        PlacedEffect(
            SHAFT_COMPLIANCE,
            # friction of the declared body may sit on either side of the spring
            (*SHAFT_COMPLIANCE.parameters, Parameter("far_viscous", "N·m·s/rad", 0.0, inf, 1.0)),
            (0, 1, 2),
        ),
        whole(BACKLASH),
        whole(SENSOR_DELAY),
        whole(SENSOR_GAIN),
        whole(ENCODER_ECCENTRICITY),
    )
}


def register(chain: PlacedEffect) -> PlacedEffect:
    """Add a user's own effect for drives of any shape.

    Raises
    ------
    ValueError
        A name that is taken, or a site that chains do not have.
    """
    if chain.name in PLACED_CATALOGUE:
        raise ValueError(f"effect {chain.name!r} is in the chain catalogue; choose another name")
    if chain.site not in SITES:
        raise ValueError(f"effect {chain.name!r}: chains have no site {chain.site!r}")
    PLACED_CATALOGUE[chain.name] = chain
    return chain
