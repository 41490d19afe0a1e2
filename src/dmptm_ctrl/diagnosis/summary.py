"""Fitted parameters as text, the way lmfit reports them."""

import platform
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.fit import Fit

LIBRARIES = ("numpy", "scipy", "numba", "control")  # that the numbers come from
SHOWN = 0.5  # correlations below are not worth a line
MOST = 10


def correlated(fit: Fit, least: float = SHOWN) -> list[tuple[str, str, float]]:
    """Return pairs of fitted parameters and their correlation, strongest first."""
    sizes = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
    matrix = fit.covariance / np.outer(sizes, sizes)
    names = [k.name if k.effect is None else f"{k.effect}.{k.name}" for k in fit.unknowns]
    found = [
        (names[i], names[j], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(matrix[i, j]) >= least
    ]
    return sorted(found, key=lambda row: -abs(row[2]))


def parameter_lines(fit: Fit, drive: Drive) -> list[str]:
    """Return a line per fitted parameter of the drive: estimate, se, declared range, bounds hit."""
    lines = ["parameters of the drive (fitted, ± standard error, declared range)"]
    wide = max((len(k.name) for k in fit.unknowns), default=0)
    for k in fit.unknowns:
        if k.effect is not None:
            continue
        value, se = fit.value(None, k.name)
        quantity = drive.quantities[k.name]
        low, high = quantity.range
        relative = f" ({100 * se / abs(value):.2g} %)" if value else ""
        edge = "  at its bound" if k.name in fit.at_bounds else ""
        lines.append(
            f"  {k.name:{wide}} = {value:.5g} ± {se:.2g}{relative} {quantity.unit}"
            f"  [{low:.4g}, {high:.4g}]{edge}"
        )
    return lines


def correlation_lines(pairs: Sequence[tuple[str, str, float]]) -> list[str]:
    """Return a line per pair of correlated parameters; the strongest ten."""
    if not pairs:
        return []
    lines = [f"correlations (|c| >= {SHOWN:g})"]
    lines += [f"  C({one}, {other}) = {value:+.3f}" for one, other, value in pairs[:MOST]]
    if len(pairs) > MOST:
        lines.append(f"  and {len(pairs) - MOST} weaker ones")
    return lines


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries that compute."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}
