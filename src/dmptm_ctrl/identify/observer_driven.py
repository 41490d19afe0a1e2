"""Speed that a model does not predict over short times.

The model runs along a log, kept near the measured angle by an observer: it forgets within
1/(2π f), f the observer's bandwidth. What the gyro reads beside it, in blocks, shows what the
balances of sliding drives do not see: reversals, first impacts on the other flank, stick and creep.
No state has to be guessed at the start of each stretch, as all that the model remembers,
bristles and delays too, comes from its own run.
Source: fixed-gain prediction errors, Ljung, System Identification, 1999, ch. 3 and 7.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

from dmptm_ctrl.identify.records import Record, block_mean
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.observer import observer_gains

BANDWIDTH_HZ = 5.0  # of the observer
MEMORY_SECONDS = 0.5 / (pi * BANDWIDTH_HZ)  # within which a run forgets where it began
STEPS = 4  # a sample; of 250 µs they miss the speed by 4e-4, far below a gyro's noise
BLOCK_SECONDS = 0.02  # passes 25 Hz; how pinions ring on their flanks is chance


@dataclass(frozen=True, eq=False)
class ObserverRun:
    """Short predictions on one log, by an observer of `bandwidth_hz`, in `steps` per sample."""

    rec: Record
    bandwidth_hz: float = BANDWIDTH_HZ
    steps: int = STEPS

    @property
    def block(self) -> int:
        """Samples of a block."""
        return max(1, round(BLOCK_SECONDS / self.rec.dt))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return self.rec.omega.size // self.block

    def missing(self, model: Model) -> Floats:
        """Speed [rad/s] that a model does not predict, in blocks, (count,)."""
        return self.missing_of([model])[0]

    def missing_of(self, models: Sequence[Model]) -> Floats:
        """Return the same of several models at once, (models, count)."""
        rec = self.rec
        runs = march_any(
            [model.over(rec.seconds) for model in models],
            rec.u,
            rec.x0,
            rec.dt,
            substeps=self.steps,
            observer=observer_gains(self.bandwidth_hz, rec.dt),
            measured=rec.theta,
            columns=(1,),
        )
        return block_mean(rec.omega - runs[:, :, 0], self.block)
