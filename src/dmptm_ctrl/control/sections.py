"""Second-order sections of a controller: notch and lead, continuous and sampled."""

from collections.abc import Sequence
from math import inf, pi, tan

import control as ct

Section = tuple[float, float, float, float, float]


def notch(hz: float, depth: float, width: float) -> ct.TransferFunction:
    """Return (s² + 2 d w ω s + ω²)/(s² + 2 w ω s + ω²), all three numbers positive.

    Its gain at the centre is `depth` d; above 1 it is a peak, which rejects a disturbance there.
    """
    if not all(0.0 < x < inf for x in (hz, depth, width)):
        raise ValueError(f"notch at {hz:g} Hz, depth {depth:g}, width {width:g}: all must be > 0")
    omega = 2.0 * pi * hz
    return ct.tf(
        [1.0, 2.0 * depth * width * omega, omega**2],
        [1.0, 2.0 * width * omega, omega**2],
        name=f"notch_{hz:.4g}_Hz".replace(".", "_"),
    )


def sampled_notch(hz: float, depth: float, width: float, sample_time: float) -> Section:
    """Return the notch as a difference equation (b0, b1, b2, a1, a2), y = b0 x + … − a1 y₋₁ − ….

    Tustin's rule with the centre held (pre-warped); it must be below half the sample rate.
    """
    if not 0.0 < hz < 0.5 / sample_time:
        raise ValueError(f"notch at {hz:g} Hz is not below half the sample rate")
    if not (0.0 < depth < inf and 0.0 < width < inf):
        raise ValueError(f"notch with depth {depth:g}, width {width:g}: both must be > 0")
    g = tan(pi * hz * sample_time)
    scale = 1.0 + 2.0 * width * g + g * g
    even = 2.0 * (g * g - 1.0) / scale
    return (
        (1.0 + 2.0 * depth * width * g + g * g) / scale,
        even,
        (1.0 - 2.0 * depth * width * g + g * g) / scale,
        even,
        (1.0 - 2.0 * width * g + g * g) / scale,
    )


def in_series(
    first: ct.StateSpace, sections: Sequence[Section], sample_time: float
) -> ct.StateSpace:
    """Return a sampled system with second-order sections behind it.

    As states and not as one polynomial: of three sections far below the sample rate its
    coefficients leave the eighth digit open, of six none.
    """
    for b0, b1, b2, a1, a2 in sections:
        own = ct.ss(
            [[-a1, 1.0], [-a2, 0.0]], [[b1 - a1 * b0], [b2 - a2 * b0]], [[1.0, 0.0]], [[b0]],
            sample_time,
        )  # fmt: skip
        first = own * first
    return first
