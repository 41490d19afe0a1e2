"""Numbers of a dual-motor drive as the loops take them, and what no drive may have."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.effects import CATALOGUE

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model

Floats = NDArray[np.float64]
Arrays = tuple[Floats, NDArray[np.uint8], Floats]  # base, on, values

BASE = (
    *("K_d", "K_M", "J_m", "J_2", "J_L", "N_1", "N_2", "z_3", "k_m", "k_a", "phi_r", "c", "c_f"),
    *("gap_l", "gap_r"),
    *("T3s_plus", "T3c_plus", "W3_plus", "B3_plus"),
    *("T3s_minus", "T3c_minus", "W3_minus", "B3_minus", "delta3"),
    *("TLs_plus", "TLc_plus", "WL_plus", "BL_plus"),
    *("TLs_minus", "TLc_minus", "WL_minus", "BL_minus", "deltaL"),
)


def refuse_negative(model: "Model") -> None:
    """Refuse effects whose size is negative where it is a magnitude, such as a stiffness.

    Raises
    ------
    ValueError
    """
    for name, values in model.effects.items():
        for parameter in CATALOGUE[name].parameters:
            value = values.get(parameter.name, 0.0)
            if parameter.low == 0.0 > value:
                raise ValueError(
                    f"effect {name}: {parameter.name} is {value:g}; it must be zero or more"
                )
