"""The slopes of the site chains of a drive without any effect; see `row_sites.py`.

`compose.py` puts the catalogue's in place. `r` holds whether an effect is in use, the numbers of
all effects, and behind them rows of slopes by these, which the chains write where `own` says so.
The last value is whether a small change leaves the branches of all kernels as they are. Of what
the loops themselves know of friction and lags `compose.py` writes the slopes too.
"""

from numba import njit

# Where the numbers of effects begin in `r`, how many there are; where rows of slopes begin, and
# how far each number of an effect is moved, as `sensitivity` lists these
R_VALUES, R_NUMBERS, R_OWN, R_MOVES = 0, 0, 0, 0


@njit
def drive_slopes_of(u, t, side, own, r):
    """Voltage after the drive's effects [V], its slope by that before; row `side`."""
    return u, 1.0, True


@njit
def lag_slopes_of(u, side, own, r):
    """Target [V] and time constant [s], slopes of both by u; rows 2 side and the next."""
    return (u, 0.0), (1.0, 0.0), True


@njit
def motor_slopes_of(u, theta_m, omega_m, t, side, own, r):
    """Torque on the motor's shaft [N·m], its slopes by u, angle, speed; row `side`."""
    return 0.0, (0.0, 0.0, 0.0), True


@njit
def mesh_slopes_of(theta_p, omega_p, theta_L, omega_L, side, own, r):
    """What shifts a mesh, four slopes of each of the four; rows 4 side and the next three."""
    return (0.0,) * 4, (0.0,) * 16, True


@njit
def friction_slopes_of(
    theta_of_0, omega_of_0, mesh_torque_of_0, body_of_0,
    theta_of_1, omega_of_1, mesh_torque_of_1, body_of_1,
    theta_of_2, omega_of_2, mesh_torque_of_2, body_of_2,
    t, own, r,
):  # fmt: skip
    """Of each body level and added torque, slopes of both by angle, speed, torque.

    Rows 2 body and the next.
    """
    found = (1.0, 0.0), (0.0,) * 6
    return found, found, found, True


@njit
def ageing_slopes_of(age_of_0, body_of_0, age_of_1, body_of_1, age_of_2, body_of_2, own, r):
    """Of each body Coulomb torque added [N·m], its slope by age; row `body`."""
    return (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), True


@njit
def load_slopes_of(theta_L, omega_L, t, own, r):
    """Torque on the ring gear [N·m], its slopes by angle and speed; row 0."""
    return 0.0, (0.0, 0.0), True


@njit
def lagged_slopes(aim, tau, kept, h):
    """Values of `lagged`; slopes of both by aim, tau, kept."""
    return (0.0, 0.0), (0.0,) * 6, (), (), (), True


@njit
def toothed_slopes(x, k_a, z_3, phi_r):
    """Value of `toothed`; its slopes by x, k_a, z_3, phi_r."""
    return (0.0,), (0.0,) * 4, (), (), (), True


@njit
def aged_slopes(age, v, h, slip):
    """Value of `aged`; its slopes by age, v, slip."""
    return (0.0,), (0.0,) * 3, (), (), (), True


@njit
def preslide_slopes(v, v_mid, force, mobility, h, law, scale, added, bristles, bristle):
    """Values of `preslide`; slopes of both by v, v_mid, force, scale, added, bristle."""
    return (0.0, 0.0), (0.0,) * 12, (), (), (), True


@njit
def preslide_own_slopes(v, v_mid, force, mobility, h, law, scale, added, bristles, bristle):
    """The same; slopes of both by distance, share and lag of the bristles."""
    return (0.0, 0.0), (0.0,) * 12, (0.0,) * 6, (), (), True
