"""The paper's PI loop on the ring-gear speed (Fig. 15), as python-control systems.

u = kp e + ki ∫ e dt,   e = ref − ω_L, the same voltage on both motors
"""

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

OUTSIDE = 1.0 + 1e-6  # of a pole in z; nearer to the circle it is rounding
EVEN = 5  # rounds that leave rows and columns of equal size
RIGID = 1e-11  # singular value of an angle that nothing reads over the largest: rounding


def pi_controller(kp: float, ki: float) -> ct.StateSpace:
    """Return G_c(s) = kp + ki/s from ``error`` [rad/s] to ``u`` [V]; gains in V/(rad/s) and V/rad.

    ValueError for a gain that is not finite.
    """
    _finite(kp, ki)
    names = {"states": ["integral"], "inputs": ["error"], "outputs": ["u"], "name": "pi"}
    return ct.ss(0.0, 1.0, ki, kp, **names)


def common_mode(plant: ct.StateSpace, output: str = "omega_L") -> ct.StateSpace:
    """Return the plant from one voltage ``u`` on both motors to one output.

    Parameters
    ----------
    plant : StateSpace
        One voltage in, or one per motor.
    output : str
        Which of its outputs, by default the speed of the ring gear.

    Returns
    -------
    StateSpace
        Without the angle of the whole drive where `output` does not depend on it.

    Raises
    ------
    ValueError
        The plant has no such output, or more than two inputs.

    Examples
    --------
    >>> dm.common_mode(dm.three_dof(dm.paper_drive())).input_labels
    ['u']
    """
    if plant.ninputs not in (1, 2):
        raise ValueError(f"the plant has {plant.ninputs} inputs, two motors make 2")
    if output not in plant.output_labels:
        hint = "; tune_controller takes a rig of any shape" * (output == "omega_L")
        has = ", ".join(plant.output_labels)
        raise ValueError(f"no output {output!r}; the plant has {has}{hint}")
    row = plant.output_labels.index(output)
    return without_rigid_angle(
        ct.ss(
            plant.A,
            plant.B.sum(axis=1, keepdims=True),
            plant.C[[row]],
            plant.D[[row]].sum(axis=1, keepdims=True),
            states=plant.state_labels,
            inputs=["u"],
            outputs=[output],
            name=plant.name,
        )
    )


def without_rigid_angle(sys: ct.StateSpace) -> ct.StateSpace:
    """Return a system without the angle of the whole drive, where no output and no rate sees it.

    Such an angle v has A v = 0 and C v = 0. The largest state of it is left out, and the others
    are counted from it. Sampled systems are returned as they are.
    """
    if sys.nstates == 0 or sys.isdtime(strict=True):
        return sys
    seen = np.vstack([sys.A, sys.C])
    seen = seen[np.abs(seen).max(axis=1) > 0.0]
    size = np.ones(sys.nstates)
    for _ in range(EVEN):  # rows and columns of one size: stiff shafts beside slow bodies
        seen = seen / np.abs(seen).max(axis=1, keepdims=True)
        column = np.abs(seen).max(axis=0)
        column[column == 0.0] = 1.0
        seen, size = seen / column, size * column
    _, values, vectors = np.linalg.svd(seen)
    values = np.append(values, np.zeros(sys.nstates - values.size))
    unread = vectors[values <= RIGID * values[0]].T / size[:, None]
    gone = qr(unread.T, pivoting=True)[2][: unread.shape[1]] if unread.size else np.array([], int)
    keep = np.setdiff1d(np.arange(sys.nstates), gone)
    from_it = np.linalg.solve(unread[gone].T, unread[keep].T).T  # rows: kept states
    return ct.ss(
        sys.A[np.ix_(keep, keep)] - from_it @ sys.A[np.ix_(gone, keep)],
        sys.B[keep] - from_it @ sys.B[gone],
        sys.C[:, keep],
        sys.D,
        states=[sys.state_labels[i] for i in keep],
        inputs=sys.input_labels,
        outputs=sys.output_labels,
        name=sys.name,
        dt=sys.dt,
    )


def close_speed_loop(plant: ct.StateSpace, kp: float, ki: float) -> ct.StateSpace:
    """Close the PI loop of Fig. 15 around a linear drive.

    The loop is continuous: it has no delay of sampling, which ``margins`` and ``tune_pi`` count.
    An unstable loop is returned like any other; its poles or ``margins`` show it.

    Parameters
    ----------
    plant : StateSpace
        One voltage [V] in, or one per motor; ``omega_L`` [rad/s] among its outputs.
    kp : float [V/(rad/s)]
    ki : float [V/rad]

    Returns
    -------
    StateSpace
        From ``ref`` [rad/s] to ``omega_L`` [rad/s] and ``u`` [V].

    Examples
    --------
    >>> closed = dm.close_speed_loop(dm.three_dof(dm.paper_drive()), kp=5.0, ki=90.0)
    >>> step = ct.step_response(closed["omega_L", "ref"])
    """
    drive = common_mode(plant)
    compare = ct.summing_junction(inputs=["ref", "-omega_L"], output="error", name="compare")
    return ct.interconnect(
        [drive, pi_controller(kp, ki), compare],
        inputs=["ref"],
        outputs=["omega_L", "u"],
        name=f"{plant.name}_closed",
    )


def sampled_drive(plant: ct.StateSpace, sample_time: float) -> ct.StateSpace:
    """Return the drive from one held voltage to ``omega_L`` as a sampled loop sees it, in z."""
    drive = common_mode(plant)
    return ct.c2d(ct.ss(drive.A, drive.B, drive.C, drive.D), sample_time, "zoh")


def sampled_pi(kp: float, ki: float, sample_time: float) -> ct.StateSpace:
    """Return the PI as it runs, in z: the error is summed after it is read."""
    _finite(kp, ki)
    step = ki * sample_time
    return ct.ss([[1.0]], [[1.0]], [[step]], [[kp + step]], sample_time, states=["sum"])


def outside_poles(open_loop: ct.StateSpace) -> NDArray[np.complex128]:
    """Return the poles in z with which a sampled loop is unstable once it is closed."""
    poles = ct.feedback(open_loop, 1).poles()
    return np.asarray(poles[np.abs(poles) > OUTSIDE], complex)


def loop_response(plant: ct.StateSpace, omega: float, sample_time: float) -> complex:
    """Response at one frequency of the plant behind the hold, (1 − e^{−jωT})/(jωT)."""
    x = omega * sample_time
    hold = 1.0 if x == 0.0 else (1.0 - np.exp(-1j * x)) / (1j * x)
    return complex(plant(1j * omega) * hold)


def _finite(kp: float, ki: float) -> None:
    for name, gain in (("kp", kp), ("ki", ki)):
        if not np.isfinite(gain):
            raise ValueError(f"{name} is {gain}; it must be a finite number")
