"""Rigs to diagnose: a second program for the paper's drive, on purpose.

Nothing here is imported from dmptm_ctrl and nothing there is imported here. The
two write the same physics twice, with other contact and friction laws, another
integrator and a finer step, so that a model which fits these logs has not been
fitted to itself. Do not unify them.

    rig = make_rig(7, effects=[("cogging", 1.0)], hidden_logs=2)
    rig.logs["open_sine_0v60"]["omega_L_deg_s"]
    rig.save("d07")

Source of the plant: Zheng et al. 2022, Tables 1 and 2, Eqs. 15 to 25, as corrected in
`rigs.nominal`.
"""

from pathlib import Path


def _forget_stale_machine_code():
    """Numba's cache of plant.py does not notice changes of the modules it calls."""
    here = Path(__file__).parent
    newest = max(path.stat().st_mtime for path in here.glob("*.py"))
    for index in here.glob("__pycache__/plant.*.nbi"):
        if index.stat().st_mtime < newest:
            index.unlink(missing_ok=True)


_forget_stale_machine_code()

from rigs.catalogue import KNOWN  # noqa: E402  after the cache is clean
from rigs.rig import Rig, make_rig  # noqa: E402
from rigs.unknowns import UNKNOWN  # noqa: E402

__all__ = ["KNOWN", "UNKNOWN", "Rig", "make_rig"]
