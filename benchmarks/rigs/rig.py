"""Draw a rig, run its experiments, write its logs."""

import copy
import gzip
import json
import math
import shutil
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from rigs import experiments, nominal
from rigs.catalogue import KNOWN
from rigs.layout import CONTACT_LAWS, FRICTION_LAWS, RECORD
from rigs.nominal import DEG
from rigs.ordinary import CONTACT, FRICTION, LAW_NAMES, ORDINARY, PLAIN, laws_that_show
from rigs.plant import SAMPLE, record_log
from rigs.unknowns import UNKNOWN

RING_ENCODER = 2 * math.pi / 2**18  # rad per count
MOTOR_ENCODER = 2 * math.pi / 10_000  # rad per count
GYRO_NOISE = 0.05 * DEG  # rad/s rms
FINE_STEP = 25e-6  # s

# Columns as in the logs of a real rig: name -> decimals.
DECIMALS = {
    "time_s": 3,
    "u_left_V": 5,
    "u_right_V": 5,
    "theta_L_deg": 5,
    "omega_L_deg_s": 4,
    "theta_ml_deg": 3,
    "theta_mr_deg": 3,
    "ref_deg_s": 5,
}


# The laws that are drawn where nobody asks for one.
DRAWN_FRICTION = ("karnopp", "lugre", "tanh")
DRAWN_CONTACT = ("eq21", "two_state", "kelvin_voigt", "hunt_crossley")


@dataclass
class Recipe:
    """What a rig is made of: `record` builds it again, whole or with something left out."""

    seed: int
    plant: np.random.Generator
    effects: tuple
    laws: dict
    spread: float | None
    meshes: tuple
    ordinary: bool

    def record(self, without=(), meshes=(1.0, 1.0)):
        """(record, what each effect drew); `without` names effects, ordinary things and laws."""
        laws = {k: PLAIN[k] if law_key(k, v) in without else v for k, v in self.laws.items()}
        record = draw_plant(copy.deepcopy(self.plant), laws, self.spread)
        record["stiffness"] *= self.meshes[0] * meshes[0]
        record["damping"] *= self.meshes[1] * meshes[1]
        p = record.view(np.recarray)[0]
        drawn = {}
        for name, strength in self.effects:
            draw = KNOWN[name] if name in KNOWN else UNKNOWN[name][0]
            if name not in without:
                drawn[name] = plain(draw(p, stream(name, self.seed), strength))
        if self.ordinary:
            exponent = laws_that_show(p, stream("laws", self.seed))
            p.exponent = exponent if laws["friction"] == "stribeck" else 0.0
            for key, (add, _) in ORDINARY.items():
                if self.key_of(key) not in without:
                    add(p, stream(f"ordinary {key}", self.seed))
        return record, drawn

    def key_of(self, ordinary):
        """A main effect of the same name keeps its own."""
        return f"usual_{ordinary}" if ordinary in dict(self.effects) else ordinary

    def things(self):
        """Key of each thing that can be left out: (name in a diagnosis or None, main)."""
        found = {n: (n if n in KNOWN else None, True) for n, _ in self.effects}
        if self.ordinary:
            found |= {self.key_of(key): (name, False) for key, (_, name) in ORDINARY.items()}
            for kind, law in self.laws.items():
                if law != PLAIN[kind]:
                    found[law_key(kind, law)] = (LAW_NAMES.get(law), False)
        return found


def law_key(kind, law):
    return f"law_{law}" if kind == "friction" else f"contact_{law}"


@dataclass
class Rig:
    """One rig: `label` says what is wrong with it, `logs` and `hidden` are tables."""

    label: dict
    logs: dict
    hidden: dict
    record: np.ndarray = field(repr=False)  # of layout.RECORD, one element
    recipe: Recipe = field(repr=False)
    experiments: dict = field(repr=False)  # of the hidden logs

    def save(self, folder):
        """Write the logs and label.json into a new folder, hidden logs into hidden/."""
        folder = write_folder(self.logs, folder)
        if self.hidden:
            write_folder(self.hidden, folder / "hidden")
        (folder / "label.json").write_text(json.dumps(self.label, indent=1) + "\n")


def make_rig(
    seed,
    effects=(),
    sensors=None,
    friction=None,
    contact=None,
    hidden_logs=0,
    *,
    logs="paper",
    spread=None,
    step=FINE_STEP,
    noise_seed=None,
    meshes=(1.0, 1.0),
    ordinary=False,
):
    """Draw a rig of the paper's kind and run its experiments.

    Parameters
    ----------
    seed : int
        Fixes everything that is drawn. The plant, the noise and each effect have
        their own streams: adding an effect changes nothing else.
    effects : sequence of (name, strength)
        Names of `KNOWN` or `UNKNOWN`; strength 1 is typical, 0 is off.
    sensors : {"all", "load"}, optional
        With or without motor encoders; drawn if left out.
    friction : {"karnopp", "lugre", "tanh", "gms", "stribeck"}, optional
    contact : {"eq21", "two_state", "kelvin_voigt", "hunt_crossley", "quadratic"}, optional
        Drawn if left out.
    hidden_logs : int or "mixed"
        Further logs at other amplitudes and phases, kept for scoring predictions;
        or the three mixed ones of `experiments.mixed`.
    logs : {"paper", "other"} or collection of str
        The ten usual logs, ten others, or only these of the usual ones.
    spread : float, optional
        Half-width of all parameter draws, relative; without it `nominal.SPREAD`.
    step : float
        Fine step of the integrator [s]; must divide a sample.
    noise_seed : int, optional
        Measures the same rig once more, with other noise.
    meshes : (float, float)
        Factors on the stiffness and the damping of what was drawn.
    ordinary : bool
        With the imperfections of `rigs.ordinary`, and laws of friction and contact from there.

    Returns
    -------
    Rig
    """
    check(effects, sensors, friction, contact, logs, step)
    streams = np.random.SeedSequence(seed).spawn(3)
    plant, starts, later = (np.random.default_rng(s) for s in streams)
    laws = {
        "friction": friction or str(plant.choice(FRICTION if ordinary else DRAWN_FRICTION)),
        "contact": contact or str(plant.choice(CONTACT if ordinary else DRAWN_CONTACT)),
    }
    drawn_sensors = str(plant.choice(["all", "load"]))
    sensors = sensors or drawn_sensors
    recipe = Recipe(seed, plant, tuple(effects), laws, spread, meshes, ordinary)
    record, drawn = recipe.record()
    label = {
        "effects": [title(name) for name, _ in effects],
        "sensors": sensors,
        "seed": seed,
        "depends_on": depends_on(effects),
        "strengths": dict(effects),
        "effect_parameters": drawn,
        "laws": laws,
    }
    bare = replace(recipe, effects=(), ordinary=False).record()[0][0]
    label["plant"] = plain({n: bare[n] for n in RECORD.names if np.any(bare[n])})

    ten = experiments.others(starts, 10) if logs == "other" else experiments.paper(starts)
    if logs not in ("paper", "other"):
        ten = {name: ten[name] for name in logs}
    if hidden_logs == "mixed":
        hidden = experiments.mixed(later)
    else:
        hidden = experiments.others(later, hidden_logs, "hidden")

    def measure(tables):
        noise = seed if noise_seed is None else noise_seed
        return {n: run(record, e, stream(n, noise), sensors, step) for n, e in tables.items()}

    return Rig(label, measure(ten), measure(hidden), record, recipe, hidden)


def stream(name, seed):
    """A generator of its own for each effect and each log."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed])


def check(effects, sensors, friction, contact, logs, step):
    for name, strength in effects:
        if name not in KNOWN and name not in UNKNOWN:
            raise ValueError(f"effect {name!r} is neither in KNOWN nor in UNKNOWN")
        if not (math.isfinite(strength) and strength >= 0):
            raise ValueError(f"strength of {name} is {strength}, it must be finite and >= 0")
    allowed = {
        "sensors": (sensors, (None, "all", "load")),
        "friction": (friction, (None, *FRICTION_LAWS)),
        "contact": (contact, (None, *CONTACT_LAWS)),
    }
    for what, (value, choices) in allowed.items():
        if value not in choices:
            raise ValueError(f"{what} is {value!r}, it must be one of {choices}")
    known = experiments.paper(np.random.default_rng(0))
    if logs not in ("paper", "other") and not (
        not isinstance(logs, str) and logs and set(logs) <= set(known)
    ):
        raise ValueError(f"logs is {logs!r}, it must be 'paper', 'other' or some of {[*known]}")
    if abs(SAMPLE / step - round(SAMPLE / step)) > 1e-9:
        raise ValueError(f"step {step} s does not divide a sample of {SAMPLE} s")


def depends_on(effects):
    """Variables of the effects on no list; named effects have none, as in a diagnosis."""
    return sorted({v for name, _ in effects if name in UNKNOWN for v in UNKNOWN[name][1]})


def title(name):
    """A catalogue effect by its name; one on no list by its description."""
    if name in KNOWN:
        return name
    return "unknown: " + UNKNOWN[name][0].__doc__.strip().rstrip(".")


def draw_plant(rng, laws, spread):
    """The paper's tables, each value moved inside its range; no effect."""
    record = np.zeros(1, RECORD)
    p = record[0]

    def near(value, kind):
        width = nominal.SPREAD[kind] if spread is None else spread
        return value * (1.0 + width * rng.uniform(-1, 1, np.shape(value)))

    p["motor_inertia"] = nominal.MOTOR_INERTIA
    p["pinion_inertia"] = near(nominal.PINION_INERTIA, "inertia")
    p["ring_inertia"] = near(nominal.RING_INERTIA, "inertia")
    p["stiffness"] = near(nominal.MESH_STIFFNESS, "stiffness")
    p["torque_per_volt"] = nominal.TORQUE_PER_VOLT
    p["damping"] = math.exp(rng.uniform(*np.log(nominal.MESH_DAMPING)))
    p["gap_damping"] = math.exp(rng.uniform(*np.log(nominal.GAP_DAMPING)))
    p["half_gap"] = near(np.array(nominal.HALF_GAPS), "gap")
    for term in ("static", "coulomb", "stribeck", "viscous"):
        reducer = near(np.array(nominal.REDUCER_FRICTION[term]), "friction")
        ring = near(np.array(nominal.RING_FRICTION[term]), "friction")
        p[term] = [reducer, reducer, ring]
    p["static"] = np.maximum(p["static"], p["coulomb"])
    p["law"] = FRICTION_LAWS[laws["friction"]]
    p["contact"] = CONTACT_LAWS[laws["contact"]]
    # Bristles bend by one or two encoder counts, tanh turns within a fraction of the
    # Stribeck speed: neither shows as presliding or as viscous friction.
    bend, turn = rng.uniform(2e-5, 4e-5), rng.uniform(0.02, 0.05) * DEG
    p["bristle"] = np.array([nominal.RING_RATIO, nominal.RING_RATIO, 1.0]) * bend
    p["smooth"] = np.array([4.0, 4.0, 1.0]) * turn
    return record


def run(record, experiment, rng, sensors, step):
    """One log as a table, quantised and rounded like the file."""
    n = experiment.signal.size
    noise = GYRO_NOISE * rng.standard_normal(n)
    raw = record_log(
        record[0],
        experiment.signal,
        experiment.closed,
        experiments.GAINS,
        experiment.preload,
        experiment.start,
        noise,
        round(SAMPLE / step),
    )
    if not np.isfinite(raw).all():
        raise FloatingPointError("the rig's simulation left the finite numbers")
    table = {
        "time_s": np.arange(n) * SAMPLE,
        "u_left_V": raw[0],
        "u_right_V": raw[1],
        "theta_L_deg": quantise(raw[2], RING_ENCODER) / DEG,
        "omega_L_deg_s": raw[3] / DEG,
    }
    if sensors == "all":
        table["theta_ml_deg"] = quantise(raw[4], MOTOR_ENCODER) / DEG
        table["theta_mr_deg"] = quantise(raw[5], MOTOR_ENCODER) / DEG
    if experiment.closed:
        table["ref_deg_s"] = experiment.signal
    return pd.DataFrame({name: np.round(x, DECIMALS[name]) + 0.0 for name, x in table.items()})


def quantise(angle, count):
    return np.round(angle / count) * count


def write_log(log, path):
    """Gzip CSV with the decimals of DECIMALS; the same log gives the same bytes."""
    row = ",".join(f"%.{DECIMALS.get(name, 7)}f" for name in log.columns) + "\n"
    text = "".join(row % values for values in zip(*(log[c] for c in log.columns), strict=True))
    with open(path, "wb") as raw, gzip.GzipFile(fileobj=raw, mode="wb", mtime=0) as packed:
        packed.write((",".join(log.columns) + "\n" + text).encode())


def write_folder(logs, folder):
    """Write logs into a folder that appears under its name only when it is whole."""
    folder = Path(folder)
    part = folder.with_name(folder.name + ".part")
    part.mkdir(parents=True, exist_ok=True)
    for name, log in logs.items():
        write_log(log, part / f"{name}.csv.gz")
    if folder.is_dir():
        shutil.rmtree(folder)
    part.rename(folder)
    return folder


def plain(value):
    """Numbers and lists that JSON knows."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else value
