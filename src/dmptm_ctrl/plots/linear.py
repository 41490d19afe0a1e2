"""Bode and step comparisons on python-control's own plots, and errors over frequency."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import ArrayLike

from dmptm_ctrl.drive.reduction import SimplificationCost
from dmptm_ctrl.plots.style import SEQUENCE, STYLES, axes

LEAST_COHERENCE = 0.1  # below, gain and phase are not drawn
LONG = 24  # letters of a label from which a legend is too wide to stand among the curves


def bode_compare(
    systems: dict[str, ct.lti.LTI],
    *,
    omega_limits: Sequence[float] | None = None,
    ax: Any = None,
    Hz: bool = True,
    dB: bool = True,
    title: str = "",
) -> ct.ControlPlot:
    """Draw SISO systems or frequency responses in one Bode plot.

    Parameters
    ----------
    systems : mapping of str to system or FrequencyResponseData
        By label; one input and one output each.
    omega_limits : (low, high), optional
        In Hz, or in rad/s with ``Hz=False``; default 0.1 to 1000.
    ax : (2,) array of Axes, optional
        Magnitude and phase.
    Hz, dB : bool
        As in ``control.bode_plot``.
    title : str

    Returns
    -------
    ControlPlot

    Raises
    ------
    ValueError
        No system, one with several inputs or outputs, or limits that are no band.

    Examples
    --------
    >>> plot = dm.bode_compare({"3-DOF": dm.common_mode(dm.three_dof(dm.paper_drive()))})
    """
    _refuse_other(systems)
    panels = axes(ax, 2, figsize=(6.5, 5.2), sharex=True)
    limits = (0.1, 1e3) if omega_limits is None else tuple(omega_limits)
    if not (len(limits) == 2 and 0.0 < limits[0] < limits[1] < np.inf):
        raise ValueError(f"omega_limits are {limits}; they must be two numbers, 0 < low < high")
    low, high = limits
    per_unit = 2 * np.pi if Hz else 1.0
    omega = per_unit * np.geomspace(low, high, 4000)  # a resonance of ζ = 0.003 has ten points
    plot = None
    for (label, system), style in zip(systems.items(), cycle(SEQUENCE), strict=False):
        sampled = isinstance(system, ct.FrequencyResponseData)
        plot = ct.bode_plot(
            system,
            None if sampled else omega,
            ax=panels,
            Hz=Hz,
            dB=dB,
            deg=True,
            grid=False,
            label=label,
            wrap_phase=False,
            initial_phase=-np.pi / 4,  # a spring's +90° and a free body's −180° as they are
            **style,
        )
    panels[0, 0].set_title(title)
    panels[0, 0].set_xlim(low, high)
    for panel in panels.ravel():
        panel.grid(alpha=0.3, which="major")
        panel.minorticks_off()
    legend = panels[0, 0].legend(fontsize=8, loc="lower left")
    if max(map(len, systems), default=0) > LONG:
        legend.remove()
        panels[1, 0].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.25))
    return plot


def step_compare(
    systems: dict[str, ct.lti.LTI],
    duration: float,
    *,
    height: float = 1.0,
    ax: Axes | None = None,
    unit: str = "",
    scale: float = 1.0,
    title: str = "",
) -> ct.ControlPlot:
    """Draw step responses of SISO systems in one plot.

    Parameters
    ----------
    systems : mapping of str to StateSpace
    duration : float [s]
    height : float
        Of the step, in the input's unit.
    ax : Axes, optional
    unit : str
        Of the output after multiplication by `scale`, with its name; by default what the systems
        call their outputs, in SI.
    scale : float
        From the output's unit to `unit`.
    title : str

    Returns
    -------
    ControlPlot

    Raises
    ------
    ValueError
        No system, or one with several inputs or outputs.

    Examples
    --------
    >>> plot = dm.step_compare({"3-DOF": dm.common_mode(dm.three_dof(dm.paper_drive()))}, 2.0)
    """
    _refuse_other(systems)
    panel = axes(ax, 1, figsize=(6.5, 3.4))
    time = np.linspace(0.0, duration, 4000)
    named = ", ".join(dict.fromkeys(system.output_labels[0] for system in systems.values()))
    unit = unit or f"{named} [SI]" + f" × {scale:g}" * (scale != 1.0)
    plot = None
    for (label, system), style in zip(systems.items(), cycle(SEQUENCE), strict=False):
        response = ct.step_response(system, time)
        shown = ct.TimeResponseData(
            time,
            scale * height * response.outputs,
            issiso=True,
            output_labels=[unit],
            plot_inputs=False,
        )
        plot = shown.plot(ax=panel, label=label, title="", **style)
    panel[0, 0].set(xlabel="time [s]", ylabel=unit, title=title, xlim=(0.0, duration))
    panel[0, 0].grid(alpha=0.3)
    panel[0, 0].legend(fontsize=8, loc="best")
    return plot


def response_plot(
    responses: Mapping[str, tuple[ct.FrequencyResponseData, ArrayLike]],
    *,
    reference: Mapping[str, Any] | None = None,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
    ax: Any = None,
    dB: bool = True,
    title: str = "",
) -> np.ndarray:
    """Draw measured responses: magnitude, phase and coherence over frequency in Hz.

    Each is (FrequencyResponseData, coherence), such as a ``FrequencyResponse``; linear systems as
    `reference` stand beside them, without coherence. Gain and phase are left out where the
    coherence is below 0.1.
    """
    ratios = {"height_ratios": [3, 3, 1.4]}
    panels = axes(ax, 3, figsize=(6.5, 6.2), grid="both", sharex=True, gridspec_kw=ratios)
    magnitude, phase, coherent = panels.ravel()
    lines: dict[str, Any] = {**responses, **(reference or {})}
    reach = np.concatenate([np.asarray(r[0].omega) for r in responses.values()])
    first = next(iter(responses.values()))[0]
    title = title or f"{first.output_labels[0]} / {first.input_labels[0]}"
    for (label, item), style in zip(lines.items(), cycle(SEQUENCE), strict=False):
        style = {**style, **(styles or {}).get(label, {})}
        seen: Any = 1.0
        if label in responses:
            data, coherence = item
            omega, values = np.asarray(data.omega), np.asarray(data.frdata[0, 0])
            style = {"marker": "o", "markersize": 3, **style}
            seen = np.asarray(coherence)
            coherent.plot(omega / (2 * np.pi), coherence, **style)
        else:
            omega = np.geomspace(reach.min(), reach.max(), 1000)
            values = np.asarray(item(1j * omega)).ravel()
        # Where friction holds, or all is impact chatter, there is no gain and no phase to speak of.
        moves = (np.abs(values) > 0.0) & (seen > LEAST_COHERENCE)
        hz, values = omega[moves] / (2 * np.pi), values[moves]
        gain = np.abs(values)
        magnitude.plot(hz, 20 * np.log10(gain) if dB else gain, label=label, **style)
        phase.plot(hz, np.degrees(np.unwrap(np.angle(values))), **style)
    magnitude.set(ylabel=f"gain [{'dB, SI' if dB else 'SI'}]", title=title, xscale="log")
    phase.set(ylabel="phase [deg]", xscale="log")
    coherent.set(ylabel="coherence", xlabel="frequency [Hz]", ylim=(0.0, 1.05), xscale="log")
    if not dB:
        magnitude.set_yscale("log")
    for panel in panels.ravel():
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
    magnitude.legend(fontsize=8)
    return panels.ravel()


def simplification_plot(
    cost: SimplificationCost, *, ax: Axes | None = None, Hz: bool = True
) -> Axes:
    """Draw what the 3-DOF model and a balanced one of the same order leave out."""
    panel = axes(ax, 1, figsize=(6.5, 4.0), grid="major")[0, 0]
    omega = np.geomspace(1.0, 1e4, 3000)
    names = {
        "full": ("9-DOF model", STYLES["measured"]),
        "three_dof": ("error of the 3-DOF model", STYLES["existing"]),
        "balanced": ("error of the balanced truncation", STYLES["proposed"]),
    }
    order = cost.balanced.nstates
    for key, values in cost.error_over(omega).items():
        label, style = names[key]
        norms = f"H∞ {cost.h_inf[key]:.3g}, H2 {cost.h_2[key]:.3g}"
        x = omega / (2 * np.pi) if Hz else omega
        panel.loglog(x, values, label=f"{label} ({norms})", **style)
    panel.set(
        xlabel="frequency [Hz]" if Hz else "frequency [rad/s]",
        ylabel="largest singular value [(rad/s)/V]",
        title=f"Voltages to speeds at the ring gear, simplified to {order} states",
        ylim=(1e-6, 10),
    )
    panel.legend(fontsize=8)
    return panel


def _refuse_other(systems: Mapping[str, Any]) -> None:
    """Refuse nothing to draw, and what has several inputs or outputs."""
    if not systems:
        raise ValueError("no systems to draw; give a dict of label to system")
    for label, system in systems.items():
        if (system.ninputs, system.noutputs) != (1, 1):
            raise ValueError(
                f"{label}: {system.ninputs} inputs and {system.noutputs} outputs, needs one of "
                "each; see common_mode, or take system[output, input]"
            )
