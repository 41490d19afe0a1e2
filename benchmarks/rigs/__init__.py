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

from rigs.catalogue import KNOWN
from rigs.rig import Rig, make_rig
from rigs.unknowns import UNKNOWN

__all__ = ["KNOWN", "UNKNOWN", "Rig", "make_rig"]
