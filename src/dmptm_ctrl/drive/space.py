"""A linear model each of whose outputs is evaluated by the states that it depends on."""

from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray


class StateSpace(ct.StateSpace):  # type: ignore[misc]  # control is untyped
    """A StateSpace in which an angle of no return does not spoil what the other outputs say.

    The angle of a drive that turns freely is a pole at 0. python-control solves for all outputs
    at once, so beside an angle the gain of a speed at 0 would be infinite. Here each output
    is evaluated with the states that it depends on, and a part of the model has no others.
    """

    def horner(self, x: Any, warn_infinite: bool = True) -> NDArray[np.complex128]:
        """Evaluate at complex frequencies; see :meth:`control.StateSpace.horner`."""
        if self.noutputs == 1:
            return np.asarray(super().horner(x, warn_infinite))
        rows = (self[i, :].horner(x, warn_infinite) for i in range(self.noutputs))
        return np.concatenate([*rows])

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
