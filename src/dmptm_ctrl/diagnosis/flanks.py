"""Which law the flanks of the meshes follow: Eq. 21, or one that damps by depth.

Balances see nothing of it, the first landings do: with the wrong law each comes out a little
otherwise, and no model keeps step. One law for the other is no effect that a drive lacks; it is
in the model without a name.
"""

from collections.abc import Sequence

from dmptm_ctrl.diagnosis.at_rest import entered, softened
from dmptm_ctrl.diagnosis.landings import FIRST_SECONDS
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import Residual, residual
from dmptm_ctrl.diagnosis.runoff import Run, run, starts
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import drive_unknowns
from dmptm_ctrl.identify.lock import UNEASY, Seeker, cut
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.damping import damping_by_depth

# Of what Eq. 21 misses there, on fitted and on held-out logs, that the right law leaves at most,
# and by how much less that is. On rigs of benchmarks/rigs that lack nothing (seed 8401) flanks that
# do damp by depth leave 0.1 to 0.6 and gain 60 and more; all others are met worse by that law.
SHARE, LEAST = 0.7, 30.0


def damp_by_depth(left: Residual, jobs: int) -> bool:
    """Whether the first landings are met by flanks that damp by depth, and not by Eq. 21's.

    Parameters
    ----------
    left : Residual
        What a model with those of Eq. 21 leaves, beside what was found.
    """
    measured = left.measured
    bare = nearest([left.base], left, jobs)
    if bare.level < UNEASY:
        return False
    model = damping_by_depth(left.base.model)
    effects = (k for k in left.base.unknowns if k.effect is not None)
    other = residual(measured, model, unknowns=(*drive_unknowns(model), *effects), jobs=jobs)
    soft = [softened(one.base, len(one.base.unknowns)) for one in (left, other)]
    # friction may give or stick with either
    met = nearest([other.base, soft[1]], left, jobs)
    if met.level > UNEASY:
        return False
    bare = min(bare, nearest([soft[0]], left, jobs), key=lambda one: one.total)
    agree = met.fitted < SHARE * bare.fitted and met.held < SHARE * bare.held
    return agree and bare.total - met.total > LEAST


def nearest(several: Sequence[BalanceFit], left: Residual, jobs: int) -> Run:
    """Bring models to the first landings; return what is missed of these by the nearest."""
    measured = left.measured

    def reached(start: BalanceFit) -> Seeker:
        one = entered(rattled(measured.fit, start, measured.drive, 1))
        for seconds in FIRST_SECONDS:
            one.go([cut(rec, seconds) for rec in measured.fit], 1)
            if one.level > UNEASY:
                one.search()
            one.settle()
        return one

    parts = starts((measured.fit, measured.held), FIRST_SECONDS[-1])
    runs = [run(parts, one.there, jobs) for one in in_threads(reached, several, jobs)]
    return min(runs, key=lambda one: one.total)
