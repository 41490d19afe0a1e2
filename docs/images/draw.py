"""Draw the README's picture: one held-out log of a rig that lacks something.

python docs/images/draw.py [LOGS]      a folder of logs; by default the bundled demo_rig
"""

import sys
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

import dmptm_ctrl
from dmptm_ctrl.data import path
from dmptm_ctrl.plots.diagnosis import plot_overlay

TARGET = Path(__file__).with_name("diagnosis.png")


def draw(diagnosis):
    """Picture of the held-out log on which the effect shows most."""
    overlay = max(diagnosis.overlays(), key=lambda o: o.rmse("before") - o.rmse("after"))
    names = " and ".join(e.name.replace("_", " ") for e in diagnosis.effects) or "nothing"
    figure = Figure(figsize=(7.6, 3.9), layout="constrained")
    panels = figure.subplots(2, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    plot_overlay(overlay, ax=panels, title=f"A log held out of the fit. Missing: {names}")
    return figure


def main():
    mpl.use("agg")
    diagnosis = dmptm_ctrl.diagnose(sys.argv[1] if len(sys.argv) > 1 else path("demo_rig"))
    draw(diagnosis).savefig(TARGET, dpi=110)


if __name__ == "__main__":
    main()
