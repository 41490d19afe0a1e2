"""The catalogue: every effect that can be simulated, added to a model, or traced.

A new effect is one file here and one line in :data:`CATALOGUE`; a user's own registers
with :func:`register`.
"""

from dmptm_ctrl.contract import SITES, Effect
from dmptm_ctrl.effects.back_emf import BACK_EMF
from dmptm_ctrl.effects.backlash_variation import BACKLASH_VARIATION
from dmptm_ctrl.effects.base_vibration import BASE_VIBRATION
from dmptm_ctrl.effects.cable_spring import CABLE_SPRING
from dmptm_ctrl.effects.cogging import COGGING
from dmptm_ctrl.effects.current_lag import CURRENT_LAG
from dmptm_ctrl.effects.drive_dead_band import DRIVE_DEAD_BAND
from dmptm_ctrl.effects.drive_delay import DRIVE_DELAY
from dmptm_ctrl.effects.drive_offset import DRIVE_OFFSET
from dmptm_ctrl.effects.drive_saturation import DRIVE_SATURATION
from dmptm_ctrl.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from dmptm_ctrl.effects.flank_damping import FLANK_DAMPING
from dmptm_ctrl.effects.load_dependent_friction import LOAD_DEPENDENT_FRICTION
from dmptm_ctrl.effects.local_spot import LOCAL_SPOT
from dmptm_ctrl.effects.mesh_error import MESH_ERROR
from dmptm_ctrl.effects.pinion_runout import PINION_RUNOUT
from dmptm_ctrl.effects.position_dependent_friction import POSITION_DEPENDENT_FRICTION
from dmptm_ctrl.effects.presliding import PRESLIDING
from dmptm_ctrl.effects.quadratic_drag import QUADRATIC_DRAG
from dmptm_ctrl.effects.reducer_compliance import REDUCER_COMPLIANCE
from dmptm_ctrl.effects.ring_gear_eccentricity import RING_GEAR_ECCENTRICITY
from dmptm_ctrl.effects.sensor_delay import SENSOR_DELAY
from dmptm_ctrl.effects.sensor_gain import SENSOR_GAIN
from dmptm_ctrl.effects.thermal_drift import THERMAL_DRIFT
from dmptm_ctrl.effects.torque_constant_mismatch import TORQUE_CONSTANT_MISMATCH
from dmptm_ctrl.effects.unbalance import UNBALANCE
from dmptm_ctrl.effects.unknown_breakaway import UNKNOWN_BREAKAWAY
from dmptm_ctrl.effects.unknown_friction import UNKNOWN_FRICTION
from dmptm_ctrl.effects.unknown_motor import UNKNOWN_MOTOR
from dmptm_ctrl.effects.unknown_torque import UNKNOWN_TORQUE
from dmptm_ctrl.effects.unknown_voltage import UNKNOWN_VOLTAGE

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        CURRENT_LAG,  # before a delay: every drive has some
        DRIVE_DELAY,
        DRIVE_OFFSET,
        DRIVE_DEAD_BAND,
        TORQUE_CONSTANT_MISMATCH,
        DRIVE_SATURATION,
        COGGING,
        BACK_EMF,
        REDUCER_COMPLIANCE,
        PINION_RUNOUT,
        RING_GEAR_ECCENTRICITY,
        BACKLASH_VARIATION,
        MESH_ERROR,
        FLANK_DAMPING,
        LOAD_DEPENDENT_FRICTION,
        POSITION_DEPENDENT_FRICTION,
        LOCAL_SPOT,
        THERMAL_DRIFT,
        PRESLIDING,
        UNBALANCE,
        CABLE_SPRING,
        QUADRATIC_DRAG,
        BASE_VIBRATION,
        ENCODER_ECCENTRICITY,
        SENSOR_GAIN,
        SENSOR_DELAY,
        UNKNOWN_VOLTAGE,
        UNKNOWN_FRICTION,
        UNKNOWN_TORQUE,
        UNKNOWN_BREAKAWAY,
        UNKNOWN_MOTOR,
    )
}


def register(effect: Effect) -> Effect:
    """Add a user's own effect to the catalogue.

    Costs one recompile of the simulator, at its next use.

    Parameters
    ----------
    effect : Effect

    Returns
    -------
    Effect
        The same.

    Raises
    ------
    ValueError
        A name that is taken, or a site that does not exist.
    """
    if effect.name in CATALOGUE:
        raise ValueError(f"effect {effect.name!r} is in the catalogue already; choose another name")
    if effect.site not in SITES:
        raise ValueError(
            f"effect {effect.name!r}: no site {effect.site!r}; sites are {', '.join(SITES)}"
        )
    CATALOGUE[effect.name] = effect
    return effect


# Curves that stand in for what has no name: fitted when nothing else explains the logs,
# never candidates among the others.
TABLES = (
    UNKNOWN_VOLTAGE.name,
    UNKNOWN_FRICTION.name,
    UNKNOWN_TORQUE.name,
    UNKNOWN_BREAKAWAY.name,
    UNKNOWN_MOTOR.name,
)

# Another law of what a drive has anyway: told by what the model leaves, never named as a lack.
LAWS = (FLANK_DAMPING.name,)
NO_CANDIDATES = (*TABLES, *LAWS)  # in the catalogue, but no candidates

__all__ = ["CATALOGUE", "LAWS", "NO_CANDIDATES", "TABLES", "register"]
