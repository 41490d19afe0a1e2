"""A linear model each of whose outputs is evaluated by the states that it depends on."""

from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

DECAYS = 10.0  # time constants after which a mode has decayed
DENSE = 8.0  # points per radian of a mode
FEWEST = 2000  # points while one decays
TURN = 6.0  # rad, where most rises are over


def system_name(text: str) -> str:
    """Name that python-control takes: without blanks and points."""
    return text.replace(" ", "_").replace(".", "_")


class StateSpace(ct.StateSpace):  # type: ignore[misc]  # control is untyped
    """A StateSpace in which an angle of no return does not spoil what the other outputs say.

    The angle of a drive that turns freely is a pole at 0. python-control solves for all outputs
    at once, so beside an angle the gain of a speed at 0 would be infinite. Here each output
    is evaluated with the states that it depends on, and a part of the model has no others.
    """

    def horner(self, x: Any, warn_infinite: bool = True) -> NDArray[np.complex128]:
        """Evaluate at complex frequencies; see :meth:`control.StateSpace.horner`."""
        if self.noutputs == 1:
            value = np.asarray(super().horner(x, warn_infinite))
            if np.all(np.asarray(x) == 0.0) and np.isfinite(value).all() and self.nstates:
                state = np.linalg.solve(self.A, -self.B)
                for _ in range(2):  # else rounding hides an output of 0 on stiff drives
                    state -= np.linalg.solve(self.A, self.A @ state + self.B)
                value[:] = (self.C @ state + self.D)[..., None]
            return value
        rows = (self[i, :].horner(x, warn_infinite) for i in range(self.noutputs))
        return np.concatenate([*rows])

    def bandwidth(self, dbdrop: float = -3) -> float:
        """Return the bandwidth [rad/s], also behind a gear that reverses: a negative gain at 0."""
        reversed_ = self.issiso() and np.real(self.dcgain()) < 0.0
        return float(ct.StateSpace.bandwidth(-self if reversed_ else self, dbdrop))

    def __getitem__(self, key: Any) -> "StateSpace":
        """Return a part, by numbers or names of outputs and inputs, and the states it needs."""
        part = super().__getitem__(key)
        seen = np.any(part.C != 0.0, axis=0)
        for _ in range(seen.size):  # what is seen depends on these too
            seen |= np.any(part.A[seen] != 0.0, axis=0)
        kept = np.flatnonzero(seen)
        return StateSpace(
            part.A[np.ix_(kept, kept)], part.B[kept], part.C[:, kept], part.D, part.dt,
            states=[self.state_labels[i] for i in kept], inputs=part.input_labels,
            outputs=part.output_labels, name=part.name,
        )  # fmt: skip


def step_info(system: ct.StateSpace | ct.TimeResponseData, output: str = "") -> dict[str, float]:
    """Return python-control's numbers of a step, of a linear model or of a simulated run.

    ``control.step_info`` looks at 5000 points at most. Those of a stiff drive with little damping
    miss its peaks, or end before it settles. Here each pole adds points of its own.

    Parameters
    ----------
    system : StateSpace or TimeResponseData
        A model with one input, continuous and stable. Or a run whose inputs
        change once: time and output count from there. Under a loop ``omega_L`` ends at the
        setpoint; else an output ends at its last value.
    output : str, optional
        By default the only one of a model; ``omega_L`` of a run, else its first.

    Returns
    -------
    dict
        ``RiseTime``, ``SettlingTime`` [s], ``Overshoot`` [%], ``SteadyStateValue`` and others;
        NaN where the output of a model returns to 0.

    Raises
    ------
    ValueError
        An output that is not there, several inputs or outputs, sampled, or a pole that does not
        decay. Of a run, inputs that change more than once.

    Examples
    --------
    >>> round(dm.step_info(dm.common_mode(dm.three_dof(dm.paper_drive())))["SettlingTime"], 2)
    1.07
    >>> time = np.arange(0.0, 2.0, 1e-3)
    >>> loop = dm.Loop(kp=5.0, ki=90.0, limit=10.0, bias_l=0.3, bias_r=-0.3)
    >>> run = dm.close_loop(dm.Model(), loop, time, np.where(time < 0.5, 0.0, 0.2))
    >>> round(dm.step_info(run)["Overshoot"])  # %
    10
    """
    if isinstance(system, ct.TimeResponseData):
        return _of_run(system, output)
    if output:
        if output not in system.output_labels:
            known = ", ".join(system.output_labels)
            raise ValueError(f"no output {output!r}; the model has {known}")
        system = system[output, system.input_labels]
    decay = -system.poles().real
    if not system.issiso() or not system.isctime() or (decay <= 0.0).any():
        raise ValueError("a step response needs one input, one output, and poles that decay")
    times, values, rates = [np.zeros(1)], [np.ravel(system.D)], np.abs(system.poles())
    spans = {*(DECAYS / decay), *(TURN / rates)}  # from the start to the end of each mode
    for span in sorted({float(f"{span:.3g}") for span in spans}):
        fastest = rates[DECAYS / decay > 0.99 * span].max()
        time = np.linspace(0.0, span, max(FEWEST, int(span * fastest * DENSE)))
        times.append(time)
        values.append(ct.step_response(system, time).outputs)
    time, order = np.unique(np.concatenate(times), return_index=True)
    final = float(np.real(system.dcgain()))
    seen = np.concatenate(values)[order]
    peak = seen[np.abs(seen).argmax()]
    info = ct.step_info(seen, time, yfinal=final or peak or 1.0)
    if final == 0.0:  # a share of nothing
        of_final = {*info} - {"Peak", "PeakTime"}
        info |= {key: 0.0 if key == "SteadyStateValue" else np.nan for key in of_final}
    return dict(info)


def _of_run(run: ct.TimeResponseData, output: str) -> dict[str, float]:
    """Numbers of the one step in a run."""
    names = list(run.output_labels)
    name = output or ("omega_L" if "omega_L" in names else names[0])
    if name not in names:
        raise ValueError(f"no output {name!r}; the run has {', '.join(names)}")
    time, inputs = np.asarray(run.time), np.atleast_2d(np.asarray(run.inputs))
    changes = 1 + np.flatnonzero(np.diff(inputs).any(axis=0))
    if changes.size > 1:
        raise ValueError(f"the inputs of the run change {changes.size} times, a step changes once")
    at = int(changes[0]) if changes.size else 0
    values = np.atleast_2d(np.asarray(run.outputs))[names.index(name)]
    before = values[max(at - 1, 0)]
    controlled = name == "omega_L" and "ref" in run.input_labels
    final = (inputs[0] if controlled else values)[-1]
    return dict(ct.step_info(values[at:] - before, time[at:] - time[at], yfinal=final - before))
