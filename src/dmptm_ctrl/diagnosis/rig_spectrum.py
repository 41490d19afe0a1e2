"""Gain of a rig file's drive over frequency, measured and of the models, beside its resonances."""

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from dmptm_ctrl.identify.frequency_response import FrequencyResponse, from_log
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.plots.page import data_uri
from dmptm_ctrl.plots.quality import Spectrum, plot_spectrum
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.model import Floats

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.rig_report import RigSource

SEGMENT = 2.0  # s; its inverse is the resolution
FEWEST = 8  # segments of a log
LINES = 12  # fewer are no curve
AROUND = 3.0  # times below and above the marks that is shown
LINEAR = 0.5  # coherence


def spectrum(source: "RigSource", marks: Mapping[str, float]) -> Spectrum | None:
    """Return the gains on the held-out log that excites most frequencies, with `marks` [Hz].

    None where no log shows a curve.
    """
    low, high = min(marks.values()) / AROUND, max(marks.values()) * AROUND

    def curve(log: Log) -> tuple[Floats, Floats]:
        found = _response(source, log)
        if found is None:
            return np.zeros(0), np.zeros(0)
        use = (found.hz > low) & (found.hz < high)
        return found.hz[use], np.abs(found.values[use])

    shown = {log.name: curve(log) for log in source.runs.logs}
    name = max(shown, key=lambda n: shown[n][0].size)
    if shown[name][0].size < LINES:
        return None
    log = next(one for one in source.runs.logs if one.name == name)
    before, after = source.selection.base.held_state, source.selection.final.held_state
    curves = {
        "measured": shown[name],
        "before": curve(_run(source, before, log)),
        "after": curve(_run(source, after, log)),
    }
    sensor, rate = source.runs.sensor, source.runs.sensor.measures == "position"
    factor, drive = parse_unit(sensor.unit).factor, source.rig.inputs[0]
    unit = f"({source.runs.unit})" if "/" in source.runs.unit else source.runs.unit
    by_input = parse_unit(drive.unit).factor / factor
    return Spectrum(
        {
            label: (hz, by_input * gain * (2.0 * np.pi * hz if rate else 1.0))
            for label, (hz, gain) in curves.items()
        },
        f"{sensor.name} over {drive.name} [{unit}/{drive.unit}]",
        marks,
    )


def _run(source: "RigSource", state: State, log: Log) -> Log:
    """Return a log as a model would have given it."""
    with np.errstate(all="ignore"):
        seen = source.runs.reading(state, log)
    return Log(log.name, log.time, {**log.channels, source.runs.sensor.channel: seen})


def _response(source: "RigSource", log: Log) -> FrequencyResponse | None:
    """Return the response of the compared sensor to the first input; None where there is none."""
    drive, sensor = source.rig.inputs[0], source.runs.sensor
    segment = min(SEGMENT, log.duration / FEWEST)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return from_log(
                log, drive.channel, sensor.channel, segment=segment, min_coherence=LINEAR
            )
    except (ValueError, LogError):
        return None


def spectrum_uri(found: Spectrum) -> str:
    """Draw gains as a picture inside a page."""
    figure = Figure(figsize=(7.4, 3.4), layout="constrained")
    plot_spectrum(found, ax=figure.subplots())
    return data_uri(figure)
