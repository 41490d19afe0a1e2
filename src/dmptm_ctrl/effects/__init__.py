"""The catalogue: every effect that can be simulated, added to a model, or traced.

A new effect is one file here and one name in :data:`CATALOGUE`; a user's own registers
with :func:`register`.
"""

from importlib import import_module

from dmptm_ctrl.contract import SITES, Effect

# Curves that stand in for what has no name: fitted when nothing else explains the logs,
# never candidates among the others.
TABLES = (
    *("unknown_voltage", "unknown_friction", "unknown_torque", "unknown_breakaway"),
    "unknown_motor",
)


def effect_of(name: str) -> Effect:
    """Return the effect of the file of its name, in which it is called so in capitals."""
    found: Effect = getattr(import_module(f"{__name__}.{name}"), name.upper())
    return found


CATALOGUE: dict[str, Effect] = {
    name: effect_of(name)
    for name in (
        "current_lag",  # before a delay: every drive has some
        *("drive_delay", "drive_offset", "drive_dead_band", "torque_constant_mismatch"),
        *("drive_saturation", "cogging", "back_emf", "reducer_compliance", "pinion_runout"),
        *("ring_gear_eccentricity", "backlash_variation", "mesh_error"),
        *("load_dependent_friction", "position_dependent_friction", "local_spot"),
        *("thermal_drift", "presliding", "unbalance", "cable_spring", "quadratic_drag"),
        *("base_vibration", "encoder_eccentricity", "sensor_gain", "sensor_delay"),
        *TABLES,
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

    Examples
    --------
    >>> from dmptm_ctrl.effects import CATALOGUE
    >>> tilt = dm.register_effect(CATALOGUE["unbalance"]._replace(name="tilt"))
    """
    if effect.name in CATALOGUE:
        raise ValueError(f"effect {effect.name!r} is in the catalogue already; choose another name")
    if effect.site not in SITES:
        raise ValueError(
            f"effect {effect.name!r}: no site {effect.site!r}; sites are {', '.join(SITES)}"
        )
    CATALOGUE[effect.name] = effect
    return effect


__all__ = ["CATALOGUE", "TABLES", "effect_of", "register"]
