"""When the teeth of links that are measured at both ends push, and where their gaps are."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from dmptm_ctrl.identify.following import lately_changed, touching
from dmptm_ctrl.identify.forces import forces_of
from dmptm_ctrl.identify.free_parameters import same_twist
from dmptm_ctrl.identify.inverse_dynamics import TAIL, Balance
from dmptm_ctrl.identify.measured_motion import NONE, Motion, Moves, reading_variance
from dmptm_ctrl.identify.teeth import toothed, twist_of
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import BACKLASH
from dmptm_ctrl.simulate.plant import link_matrices
from dmptm_ctrl.simulate.rig_model import RigModel

SWINGS = 2.0  # periods of the bandwidth, over which it is looked at how far teeth swing


def in_contact(balance: Balance, model: RigModel, logs: Sequence[Log]) -> Balance:
    """Find the middle of the gaps, and mark when teeth touch, by a model on the logs."""
    return marked(centred(with_gaps(balance, model), model), model, logs)


def marked(balance: Balance, model: RigModel, logs: Sequence[Log]) -> Balance:
    """Mark when teeth touch, and on which flank; a balance without teeth comes back as it is."""
    return pushing(touching(with_gaps(balance, model), model, logs), model, logs)


def with_gaps(balance: Balance, model: RigModel) -> Balance:
    """Take the twists of gaps that a model has beside the declared ones as those are taken."""
    found = {e.on for e in model.effects if e.name == BACKLASH.name}
    teeth = toothed(model.rig, balance.points, found)
    return replace(balance, teeth=teeth, known={}, noises={}) if teeth != balance.teeth else balance


def centred(balance: Balance, model: RigModel) -> Balance:
    """Count twists from the middle of their gaps: encoders start anywhere.

    Where a log holds one flank alone, the torque shows which.
    """
    motions = list(balance.motions)
    for name in balance.teeth:
        gap = model.value(f"link.{name}.half_gap")
        seen = []
        for m in motions:
            forces = forces_of(model, balance, m)
            seen.append((forces.twists[name][0], forces.carried[name]))
        each = range(len(seen))
        groups = [[i for i in each if motions[i].name == log] for log in balance.logs]
        groups = [[*each]] if same_twist(model, balance, name) else groups
        for group in groups:
            z, torque = (np.concatenate([seen[i][part] for i in group]) for part in (0, 1))
            low, high = np.quantile(z, [TAIL, 1.0 - TAIL])
            middle = 0.5 * (low + high)
            if high - low < gap:
                middle -= gap * np.sign(np.mean(torque))
            for i in group:
                here = motions[i].zero.get(name, 0.0) + float(middle)
                motions[i] = replace(motions[i], zero={**motions[i].zero, name: here})
    return replace(balance, motions=tuple(motions))


def pushing(balance: Balance, model: RigModel, logs: Iterable[Log]) -> Balance:
    """Tell on which flank teeth push, how much they swing there, and when they change it.

    The torque that the balance of one side asks of them shows the flank: errors of teeth may be
    as large as the gap. Teeth that bounce are off it by about as much as they swing.
    """
    if not balance.teeth:
        return balance
    named = {log.name: log for log in logs}
    found: list[dict[str, tuple[Floats, Floats]]] = []  # wind-up and swing of each link
    for motion in balance.motions:
        forces, of_links = forces_of(model, balance, motion), {}
        for name, (*_, stiffness) in forces.twists.items():
            wound = uniform_filter1d(forces.carried[name], _span(motion)) / stiffness
            swing = _swing(balance, model, named[motion.name], name, motion)
            of_links[name] = wound, swing
        found.append(of_links)
    tiny = np.finfo(float).tiny
    usual = {
        name: float(np.mean(np.concatenate([one[name][0] ** 2 for one in found]))) + tiny
        for name in balance.teeth
    }
    motions = []
    for motion, of_links in zip(balance.motions, found, strict=True):
        loose, flank, calm = {}, {}, {}
        for name, (wound, swing) in of_links.items():
            flank[name] = np.where(wound > 0.0, 1.0, -1.0)
            loose[name] = lately_changed(flank[name], motion.dt).astype(float)
            calm[name] = 1.0 / np.sqrt(1.0 + swing / usual[name])
        motions.append(replace(motion, loose=loose, flank=flank, calm=calm))
    return replace(balance, motions=tuple(motions), known={}, noises={})


def _span(motion: Motion) -> int:
    return max(3, round(SWINGS / (motion.bandwidth * motion.dt)))


def _swing(balance: Balance, model: RigModel, log: Log, name: str, motion: Motion) -> Floats:
    """Variance of a twist around each sample beyond the readings' noise, (n,)."""
    layout, plant = model.layout, model.plant()
    raw: Moves = {}
    rows, noise = link_matrices(plant)[0][layout.links.index(name)], {}
    for point in reversed(balance.points):
        if (sensor := point.sight.angle) is not None:
            body, reading = layout.sensor_body[point.name], log[sensor.channel][motion.samples]
            group, q = layout.coordinate[body], reading / layout.ratio[body]
            raw[group] = q, np.zeros_like(q), np.zeros_like(q)
            lever = rows[group] / layout.ratio[body]
            noise[group] = lever**2 * reading_variance(sensor, reading)
    z = twist_of(model, name, motion, raw, NONE)[0]
    z = z - z.mean()
    mean, square = (uniform_filter1d(x, _span(motion)) for x in (z, z**2))
    return np.asarray(np.maximum(square - mean**2 - sum(noise.values()), 0.0))
