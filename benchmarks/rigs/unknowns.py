"""Effects on nobody's list, each with the variables it truly depends on.

The first line of a docstring is the label. Variables are those of the diagnosis
contract (`depends_on`), the decisive one first.
"""

import numpy as np

from rigs.catalogue import between, near, phase, sign
from rigs.layout import DETENTS
from rigs.nominal import ARCMIN, DEG


def unpowered_motor(p, rng, strength):
    """One motor is unpowered for a few tens of milliseconds at fixed intervals."""
    p.cut_motor, p.cut_period = int(rng.integers(2)), rng.uniform(0.4, 0.9)
    p.cut_length, p.cut_start = min(0.3, 0.03 * strength), rng.uniform(0.1, 0.4)
    motor = ("left", "right")[int(p.cut_motor)]
    return {"motor": motor, "period_s": p.cut_period, "length_s": p.cut_length}


def dwell_breakaway(p, rng, strength):
    """The ring gear's breakaway friction grows with the logarithm of its time at rest."""
    p.dwell_rise, p.dwell_time = near(rng, 5.0 * strength), between(rng, 0.005, 0.02)
    return {"rise_N_m": p.dwell_rise, "time_s": p.dwell_time}


def voltage_ripple(p, rng, strength):
    """Torque ripple over the ring gear's angle in proportion to the voltage's size."""
    p.ripple, p.ripple_order = near(rng, 6.0 * strength), int(rng.integers(3, 9))
    p.ripple_phase = phase(rng)
    return {"N_m_per_V": p.ripple, "order": p.ripple_order}


def ratchet(p, rng, strength):
    """The ring gear falls into detents at irregular angles."""
    p.detent, p.detent_width = near(rng, 4.0 * strength), rng.uniform(0.8, 2.0) * DEG
    gaps = rng.uniform(0.4, 1.6, DETENTS)
    p.detent_place = phase(rng) + 2 * np.pi * np.cumsum(gaps) / gaps.sum()
    return {"peak_N_m": p.detent, "sigma_deg": p.detent_width / DEG}


def soft_flank(p, rng, strength):
    """Both meshes are soft on one flank and harden with the torque."""
    amount = near(rng, 6.0 * strength)
    p.soft_tooth = amount * ARCMIN
    return {"softness_arcmin": amount}


def flash_heat(p, rng, strength):
    """Friction rises with the heat that the last seconds of motion left in the bearing."""
    p.flash_rise, p.flash_heat = near(rng, 6.0 * strength), rng.uniform(3, 8)
    p.flash_time = between(rng, 0.6, 3.0)
    return {"rise_N_m": p.flash_rise, "time_constant_s": p.flash_time}


def sector_brake(p, rng, strength):
    """A magnetic brake slows the ring gear in one sector of its turn."""
    p.sector_brake = near(rng, 15.0 * strength)
    p.sector_place, p.sector_half = rng.uniform(-25, 25) * DEG, rng.uniform(8, 25) * DEG
    return {
        "N_m_s_rad": p.sector_brake,
        "place_deg": p.sector_place / DEG,
        "half_width_deg": p.sector_half / DEG,
    }


def slosh(p, rng, strength):
    """A loose mass swings on the ring gear."""
    p.slosh_inertia = near(rng, 0.8 * strength)
    p.slosh_rate, p.slosh_damping = 2 * np.pi * between(rng, 1.5, 6.0), rng.uniform(0.03, 0.1)
    return {"inertia_kg_m2": p.slosh_inertia, "frequency_Hz": p.slosh_rate / (2 * np.pi)}


def slew_limit(p, rng, strength):
    """The drive follows its command no faster than so many volts per second."""
    rate = near(rng, 1.0) * 60.0
    p.slew = rate / strength if strength > 0 else 0.0
    return {"limit_V_s": p.slew}


def high_speed_grab(p, rng, strength):
    """Above one speed a brake sticks on and lets go only below another."""
    p.grab, p.grab_on = near(rng, 4.0 * strength), rng.uniform(11, 14) * DEG
    p.grab_off = rng.uniform(0.4, 0.7) * p.grab_on
    return {"N_m": p.grab, "on_deg_s": p.grab_on / DEG, "off_deg_s": p.grab_off / DEG}


def supply_sag(p, rng, strength):
    """Each time the voltage's size passes a threshold the supply sags for a while."""
    p.sag, p.sag_voltage = min(0.9, near(rng, 0.12 * strength)), rng.uniform(0.50, 0.58)
    p.sag_time = rng.uniform(0.06, 0.15)
    return {"share": p.sag, "threshold_V": p.sag_voltage, "length_s": p.sag_time}


def dead_commutation(p, rng, strength):
    """Both motors lose part of their torque in one sector of the motor angle."""
    p.dead_sector = min(1.0, near(rng, 0.08 * strength))
    p.dead_sector_place, p.dead_sector_half = phase(rng), rng.uniform(20, 45) * DEG
    return {"share": p.dead_sector, "half_width_deg": p.dead_sector_half / DEG}


def weak_braking(p, rng, strength):
    """The motors give less torque while they brake than while they drive."""
    p.regeneration = min(0.9, near(rng, 0.15 * strength))
    return {"share": p.regeneration}


def slipping_hub(p, rng, strength):
    """The pinions creep on their hubs above one mesh torque."""
    p.slip_torque = near(rng, 1.0) * 5.0 if strength > 0 else 0.0
    p.slip_damping = 30.0 / strength if strength > 0 else 0.0
    return {"torque_N_m": p.slip_torque, "damping_N_m_s_rad": p.slip_damping}


def hook(p, rng, strength):
    """A hook catches the ring gear beyond one angle and lets go at another."""
    p.hook, p.hook_off = near(rng, 12.0 * strength), rng.uniform(-15, 5) * DEG
    p.hook_on = rng.uniform(4, 10) * DEG
    return {
        "N_m_rad": p.hook,
        "release_deg": p.hook_off / DEG,
        "catch_deg": (p.hook_off + p.hook_on) / DEG,
    }


def knocks(p, rng, strength):
    """Something knocks on the ring gear at fixed intervals."""
    p.knock, p.knock_period = near(rng, 12.0 * strength), rng.uniform(0.7, 1.3)
    p.knock_length, p.knock_start = rng.uniform(0.03, 0.06), rng.uniform(0.1, 0.4)
    return {"N_m": p.knock, "period_s": p.knock_period, "length_s": p.knock_length}


def coarse_command(p, rng, strength):
    """The drive rounds its command to coarse steps."""
    p.command_step = near(rng, 0.08 * strength)
    return {"step_V": p.command_step}


def howl(p, rng, strength):
    """An order of the ring gear's turn shakes it, most at one speed."""
    p.howl, p.howl_order = near(rng, 4.0 * strength), int(rng.integers(18, 60))
    p.howl_phase, p.howl_speed = phase(rng), rng.uniform(8, 18) * DEG
    p.howl_width = 0.25 * p.howl_speed
    return {"N_m": p.howl, "order": p.howl_order, "speed_deg_s": p.howl_speed / DEG}


def fading_motors(p, rng, strength):
    """Both motors lose torque in the course of a log."""
    p.fade, p.fade_time = min(0.8, near(rng, 0.12 * strength)), between(rng, 1.0, 5.0)
    return {"share": p.fade, "time_constant_s": p.fade_time}


def weak_polarity(p, rng, strength):
    """The drive gives less torque for negative commands."""
    p.polarity = min(0.9, near(rng, 0.06 * strength))
    return {"share": p.polarity}


def command_play(p, rng, strength):
    """The drive follows its command with play, as through a worn linkage."""
    p.play = near(rng, 0.03 * strength)
    return {"half_width_V": p.play}


def torque_ripple(p, rng, strength):
    """The torque of each volt ripples over the motor's turn."""
    p.torque_ripple = min(0.9, near(rng, 0.12 * strength))
    p.torque_ripple_order, p.torque_ripple_phase = int(rng.integers(2, 13)), phase(rng, 2)
    return {"share": p.torque_ripple, "order": p.torque_ripple_order}


def speed_bump(p, rng, strength):
    """The ring gear's friction is higher around one speed."""
    p.bump, p.bump_speed = near(rng, 4.0 * strength), rng.uniform(5, 12) * DEG
    p.bump_width = rng.uniform(0.15, 0.3) * p.bump_speed
    return {"N_m": p.bump, "speed_deg_s": p.bump_speed / DEG}


def soft_wall(p, rng, strength):
    """Beyond one angle a spring pushes the ring gear back."""
    p.wall, p.wall_place = near(rng, 20.0 * strength), sign(rng) * rng.uniform(5, 20) * DEG
    return {"N_m_rad": p.wall, "place_deg": p.wall_place / DEG}


def late_brake(p, rng, strength):
    """A brake drags on the ring gear for the first seconds of each log."""
    p.late_brake, p.late_brake_time = near(rng, 5.0 * strength), rng.uniform(0.8, 2.5)
    return {"N_m": p.late_brake, "length_s": p.late_brake_time}


UNKNOWN = {
    effect.__name__: (effect, variables)
    for effect, variables in (
        (unpowered_motor, ("time", "u")),
        (dwell_breakaway, ("time_at_rest",)),
        (voltage_ripple, ("theta_L", "u")),
        (ratchet, ("theta_L",)),
        (soft_flank, ("mesh_torque",)),
        (flash_heat, ("omega_L", "time")),
        (sector_brake, ("theta_L", "omega_L")),
        (slosh, ("omega_L",)),
        (slew_limit, ("du_dt", "u")),
        (high_speed_grab, ("omega_L",)),
        (supply_sag, ("u",)),
        (dead_commutation, ("theta_m", "u")),
        (weak_braking, ("omega_m", "u")),
        (slipping_hub, ("mesh_torque",)),
        (hook, ("theta_L",)),
        (knocks, ("time",)),
        (coarse_command, ("u",)),
        (howl, ("theta_L", "omega_L")),
        (fading_motors, ("time", "u")),
        (weak_polarity, ("u",)),
        (command_play, ("u", "du_dt")),
        (torque_ripple, ("theta_m", "u")),
        (speed_bump, ("omega_L",)),
        (soft_wall, ("theta_L",)),
        (late_brake, ("time", "omega_L")),
    )
}
