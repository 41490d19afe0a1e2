"""What a generated step is put together from; no physics of its own.

Scheme, per step h, second order where the motion is smooth: half a step of the coordinates
with the old speed; torques at the midpoint, with the speed extrapolated by its last change;
speed update with friction as a set-valued law (Moreau & Jean: a body whose speed would change
sign within the step stops, and stays while its breakaway torque holds the net torque); half a
step of the coordinates with the new speed. The jump of a mesh torque at a flank is weighted by
its share of the step, which keeps the order through contacts.

Choices are ternaries, so that a loop over lanes becomes vector code.
"""

from math import exp

from numba import njit

from dmptm_ctrl.effects.backlash import gap_rate, impact_step, mesh_region, region_torque
from dmptm_ctrl.effects.presliding import build_up_distance, fading
from dmptm_ctrl.effects.stribeck import sliding_torque, viscous_torque

UNKNOWN = 2.0  # region of a link before the first step
TINY = 1e-300  # a speed that has a direction and no size


@njit
def mesh_step(z, z_rate, law, before, h):
    """Mean torque of a mesh [N·m] over one step, and its region of Eq. 21.

    The torque jumps where a flank is reached. Since the midpoint before, the jump has acted
    for as long as the flank has been reached, the midpoint rule takes half a step.
    """
    region = mesh_region(z, z_rate, law)
    torque = region_torque(z, z_rate, region, law)
    lands = (before == 0.0 or before == -region) and region * z_rate > 0.0
    return torque + (_impact_torque(z, z_rate, law, h) if lands else 0.0), region


@njit
def plain_mesh(z, z_rate, law, before):
    """Do the same where it is simple; and return 1 where it is not, 0 where it is."""
    side = 1.0 if z >= 0.0 else -1.0
    spring, closing = law.stiffness * (side * z - law.half_gap), side * z_rate
    touches = spring + law.damping * closing > 0.0
    sure = closing <= 0.0 or spring >= law.gap_damping * closing
    region = side if touches and sure else 0.0
    lands = (before == 0.0 or before == -region) and region * z_rate > 0.0
    odd = 1.0 if lands or (touches and not sure) else 0.0
    return region_torque(z, z_rate, region, law), region, odd


@njit
def _impact_torque(z, z_rate, law, h):
    """What an impact adds to the midpoint's torque."""
    age, jump = impact_step(z, z_rate, law)
    return (min(max(age / h, 0.0), 1.0) - 0.5) * jump


@njit
def two_state_step(z, z_rate, position, law, h):
    """Torque of a mesh whose place in the gap is a state, at the midpoint, and that place later.

    Relaxation towards the place without torque is taken exactly, or steps would have to be
    shorter than (c + c_f)/k.
    """
    relaxation = law.damping + law.gap_damping
    rate = gap_rate(position, z, z_rate, law)
    kept = exp(-0.5 * h * law.stiffness / relaxation)
    span = relaxation / law.stiffness
    half = position + rate * span * (1.0 - kept)
    half = min(max(half, -law.half_gap), law.half_gap)
    after = position + rate * span * (1.0 - kept * kept)
    after = min(max(after, -law.half_gap), law.half_gap)
    moved = gap_rate(half, z, z_rate, law)
    return law.stiffness * (z - half) + law.damping * (z_rate - moved), after


@njit
def at_rest(v, new, way, rest, hold, force, step_over_inertia):
    """Speed after a step of a body that rests, or would be carried through rest to `new`.

    `hold` is what friction holds against `rest`, the direction of the force.
    `step_over_inertia` is h/J.
    """
    share = abs(new) / (abs(v) + abs(new)) if v != 0.0 else 1.0  # of the step, behind the stop
    moves = max(share * (abs(force) - hold) * step_over_inertia, 0.0) * rest
    return moves if rest * way < 0.0 or v == 0.0 else 0.0


@njit
def preslide(v, v_mid, force, step_over_inertia, h, level, at_once, bristle, distance, lag, law):
    """Speed and friction after one step where friction is a spring before it slides."""
    way = 1.0 if v_mid > 0.0 else -1.0
    # of what is left to build up, after half of the step; one at rest, where nothing does
    half = exp(-0.5 * abs(v_mid) * h / build_up_distance(distance, level, law))
    middle = bristle + (level - bristle) * (1.0 - half)
    built = (level - bristle) * (1.0 - half * half)
    damping = lag * fading(v_mid, way, law) * built / h
    return v + (force - middle - damping - at_once) * step_over_inertia, bristle + built


@njit
def lagged(state, aim, tau, h):
    """Mean of a first-order lag over one step, and its state after."""
    time = tau if tau > 0.0 else 1.0
    kept = (state - aim) * exp(-h / time)
    mean = aim + (state - aim - kept) * time / h
    return (mean if tau > 0.0 else aim), (aim + kept if tau > 0.0 else aim)


@njit
def aged(age, v, h, slip):
    """Age of a contact a time `h` later [s]: it grows with time, and `slip` [rad] makes it new."""
    turned = abs(v) * h / (slip if slip > 0.0 else 1.0)
    left = exp(-turned)
    moving = age * left + h * (1.0 - left) / (turned if turned > 0.0 else 1.0)
    return (moving if turned > 0.0 else age + h) if slip > 0.0 else 0.0


@njit
def friction(omega, way, scale, added, law):
    """Magnitude of friction of a body that slides `way` [N·m]."""
    level = scale * (sliding_torque(omega, way, law) + added)
    return level if level > 0.0 else 0.0


@njit
def at_once(omega, way, scale, share, law):
    """Part of it that presliding does not hold back, with its sign [N·m]."""
    return way * share * scale * viscous_torque(omega, way, law)
