"""Load-dependent friction: what the mesh carries presses on the bearings.

Coulomb friction += μ |T_mesh| on each reducer
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def load_friction(theta, omega, t, mesh_torque, body, p):
    """Factor on the declared friction (1) and added Coulomb torque [N·m]."""
    if body == 2:
        return 1.0, 0.0
    return 1.0, p.coefficient * abs(mesh_torque)


@njit
def body_load_friction(theta, omega, t, load, body, p):
    """The same on any body of a drive: `load` is what its links and motors put on it."""
    return 1.0, p.coefficient * abs(load)


LOAD_DEPENDENT_FRICTION = Effect(
    name="load_dependent_friction",
    site="friction",
    kernel=load_friction,
    parameters=(Parameter("coefficient", "", 0.0, 0.6, 0.01),),  # relative to the mesh torque, μ
    location="reducers",
    source="efficiency of gears under load",
    depends_on=("mesh_torque",),
    reveals="the same motion under different loads or preloads",
)
