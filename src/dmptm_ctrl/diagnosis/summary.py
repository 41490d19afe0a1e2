"""Fitted parameters as text, the way lmfit reports them."""

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from math import hypot
from typing import Any

import numpy as np
from numpy.typing import NDArray

LIBRARIES = ("numpy", "scipy", "numba", "control")  # that the numbers come from
SHOWN = 0.5  # correlations below are not worth a line
MOST = 10


def correlated(
    names: Sequence[str], covariance: NDArray[np.float64]
) -> list[tuple[str, str, float]]:
    """Return pairs of fitted parameters and their correlation, strongest first."""
    sizes = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    matrix = covariance / np.outer(sizes, sizes)
    found = [
        (names[i], names[j], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(matrix[i, j]) >= SHOWN
    ]
    return sorted(found, key=lambda row: -abs(row[2]))


def shown_names(declared: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return names of parameters for reading: what slides has a mass instead of an inertia."""
    units = {key: p.get("unit", "") for key, p in declared.items()}
    slides = {key for key, unit in units.items() if unit == "kg" or unit.endswith("·s²/m")}
    return {
        key: f"{key.removesuffix('inertia')}mass"
        if key in slides and key.endswith(".inertia")
        else key
        for key in declared
    }


def with_amplitudes(parameters: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return an effect's parameters, and the amplitude of each wave of a cosine and a sine."""
    found = dict(parameters)
    for name, c in parameters.items():
        wave = name.removesuffix("cosine")
        s = parameters.get(f"{wave}sine")
        if wave != name and s is not None:
            size = hypot(c["value"], s["value"])
            error = hypot(c["value"] * c["se"], s["value"] * s["se"]) / (size or 1.0)
            found[f"{wave}amplitude"] = {"value": size, "se": error, "unit": c["unit"]}
    return found


def parameter_lines(declared: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a line per declared parameter: estimate, se, declared range, bounds left."""
    lines = ["parameters of the drive (fitted, ± standard error, declared range)"]
    names = shown_names(declared)
    wide = max(map(len, names.values()), default=0)
    for name, p in zip(names.values(), declared.values(), strict=True):
        value, se = p["fitted"], p["se"]
        share = 100 * se / abs(value) if value else 0.0
        relative = f" ({share:{'.2g' if share < 99.5 else '.0f'}} %)" if value else ""
        text = f"  {name:{wide}} = {value:.5g} ± {se:.2g}{relative} {p['unit']}"
        if p["range"]:
            text += "  [{:.4g}, {:.4g}]".format(*p["range"])
        lines.append(text + ("  at or outside its range" if p["outside"] else ""))
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
