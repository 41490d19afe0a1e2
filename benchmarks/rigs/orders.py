"""Which rigs a campaign makes: a plan from a seed, and each rig's files and label.

DIR/ID/*.csv.gz are the logs that a diagnosis may see, DIR/ID.held/*.csv.gz judge predictions,
DIR/labels.json says what is wrong with each rig and what that is worth. Names come round in a
drawn order before one comes again; a longer plan starts with the same rigs.
"""

import zlib
from itertools import islice, product
from typing import NamedTuple

import numpy as np

from rigs import shapes, worth
from rigs.catalogue import KNOWN
from rigs.rig import make_rig, write_folder
from rigs.shape_effects import ALIKE
from rigs.unknowns import UNKNOWN

# Of ten rigs, so many with so many effects; "unknown": one on no list.
BLOCKS = {
    "dual": ("null",) * 3 + ("single",) * 5 + ("pair", "unknown"),
    "realistic": ("null",) * 2 + ("single",) * 4 + ("pair",) + ("triple",) * 3,
    "shapes": ("null",) * 2 + ("single",) * 5 + ("pair", "triple", "unknown"),
}
STRENGTHS = {"dual": (0.5, 1.0, 3.0), "realistic": (0.7, 0.85, 1.0, 1.1)}
PAIR_STRENGTHS = {"dual": (1.0, 3.0), "realistic": (0.7, 0.8, 0.9)}
MODEL_LAWS = {"friction": "karnopp", "contact": "eq21"}
# Effects that no log tells apart, or that undo each other: never together.
_ALIKE = (
    {"current_lag", "drive_delay"},
    {"pinion_runout", "ring_gear_eccentricity", "encoder_eccentricity", "backlash_variation"},
    {"position_dependent_friction", "local_spot", "load_dependent_friction"},
    {"thermal_drift", "load_dependent_friction"},
    {"unbalance", "drive_offset"},
    {"cable_spring", "drive_offset"},
    {"back_emf", "quadratic_drag"},
)
# Without motor encoders these hardly leave a trace.
_ONLY_IN_MOTOR_ANGLES = {
    "pinion_runout",
    "ring_gear_eccentricity",
    "mesh_error",
    "soft_flank",
    "slipping_hub",
}


class Order(NamedTuple):
    """One rig of a campaign."""

    id: str
    kind: str  # of campaign
    seed: int
    lacks: str  # of BLOCKS
    effects: tuple = ()  # (name, strength) of a dual drive; names of a drive of another shape
    options: tuple = ()  # of make_rig


def plan(kind, seed, count):
    """The first `count` rigs of the campaign of a seed.

    Returns
    -------
    list of Order
    """
    orders = shapes_orders(seed) if kind == "shapes" else dual_orders(kind, seed)
    return list(islice(orders, count))


def dual_orders(kind, seed):
    rng = np.random.default_rng([seed, 5, list(BLOCKS).index(kind)])
    singles, unknowns = rounds(rng, list(KNOWN)), rounds(rng, list(UNKNOWN))
    strengths = rounds(rng, list(STRENGTHS[kind]))
    i = 0
    while True:
        for lacks in rng.permutation(BLOCKS[kind]):
            i += 1
            several = {"pair": 2, "triple": 3}.get(lacks, 0)
            names = together(rng, list(KNOWN), several)
            if lacks == "single":
                names = [next(singles)]
            elif lacks == "unknown":
                names = [next(unknowns)]
            strength = [float(rng.choice(PAIR_STRENGTHS[kind])) for _ in names]
            if lacks == "single":
                strength = [next(strengths)]
            sensors = str(rng.choice(["all", "load"]))
            if _ONLY_IN_MOTOR_ANGLES & set(names):
                sensors = "all"
            options = {"sensors": sensors}
            if kind == "dual":
                options |= MODEL_LAWS
            else:
                options |= {"ordinary": True}
                if "presliding" in names:  # which is a law of its own
                    options |= {"friction": "karnopp"}
            effects = tuple(zip(names, strength, strict=True))
            at = f"s{seed}-{kind[0]}{i:03d}"
            yield Order(at, kind, 100_000 * seed + i, str(lacks), effects, (*options.items(),))


def shapes_orders(seed):
    rng = np.random.default_rng([seed, 5, list(BLOCKS).index("shapes")])
    names, unknowns = rounds(rng, list(shapes.EFFECTS)), rounds(rng, list(shapes.UNKNOWN))
    i = 0
    while True:
        for lacks in rng.permutation(BLOCKS["shapes"]):
            i += 1
            one = {"single": names, "unknown": unknowns}.get(str(lacks))
            several = {"pair": 2, "triple": int(rng.integers(3, 5))}.get(str(lacks), 0)
            effects = (next(one),) if one else together(rng, list(shapes.EFFECTS), several)
            while not shapes.fits(effects):  # no shape can have all of them
                effects = together(rng, list(shapes.EFFECTS), several)
            yield Order(f"s{seed}-b{i:03d}", "shapes", 100_000 * seed + i, str(lacks), (*effects,))


def one_by_one(kind, seeds, names, strengths):
    """Rigs with one effect each."""
    for seed, strength, name in product(seeds, strengths, names):
        at = f"{name}-x{strength:g}-s{seed}"
        if kind == "shapes":
            yield Order(at, kind, zlib.crc32(at.encode()), "single", (name,))
            continue
        options = {"sensors": ("all", "load")[seed % 2]}
        options |= MODEL_LAWS if kind == "dual" else {"ordinary": True}
        effects = ((name, strength),)
        yield Order(at, kind, zlib.crc32(at.encode()), "single", effects, (*options.items(),))


def rounds(rng, names):
    """Names for ever, each once in a drawn order before the next round."""
    while True:
        for i in rng.permutation(len(names)):
            yield names[i]


def together(rng, names, count):
    """Some names that can stand together."""
    while True:
        chosen = [str(n) for n in rng.choice(names, count, replace=False)] if count else []
        if not any(len(alike & set(chosen)) > 1 for alike in (*_ALIKE, *ALIKE)):
            return sorted(chosen)


def make(order, folder):
    """Make one rig's files; returns its label."""
    if order.kind == "shapes":
        label = shapes.make(order.seed, order.effects, folder / order.id)
    else:
        options = {"hidden_logs": "mixed", **dict(order.options)}
        rig = make_rig(order.seed, order.effects, **options)
        label = worth.label(rig)
        write_folder(rig.hidden, folder / f"{order.id}.held")
        write_folder(rig.logs, folder / order.id)
    return label | {"kind": order.kind, "lacks": order.lacks}
