"""One scorer: what a diagnosis says against what is true, for every kind of rig.

A line of results.jsonl holds what was read and the label; `score` judges it, so old lines can
be judged again. A name counts when it stands in `effects` with a probability of at least 0.5.
"""

import re
from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import beta

COUNTS = 0.5  # probability from which a name counts
EXPLAINED = 0.8  # share of the removable error that makes a verdict "explained", by the contract
LEAST = 1.5  # times the floor: below that an error shows nothing
BINS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0])  # of stated probability
SIZES = (0.0, 1.0, 3.0, 10.0, np.inf)  # rise of the error over the floor
GROUPS, UNLISTED = ("nothing", "one", "two", "three or four"), "on no list"
OUTCOMES = ("right", "immaterial", "absent", "missed", "refused")
TWINS = {"current_lag": "drive_delay", "drive_delay": "current_lag"}  # one lag, two shapes
LEFT_OUT = "sensor_delay"  # of the Brier score: every rig has some, hardly one shows it
NINETY = 1.645  # standard errors of a two-sided interval of 90 %
DEG = np.pi / 180
# effect -> name in the label: name in the product, and factor between their units
SAME = {
    "current_lag": {"time_constant_s": ("time_constant", 1.0)},
    "drive_delay": {"delay_s": ("delay", 1.0)},
    "sensor_delay": {"delay_s": ("delay", 1.0)},
    "sensor_gain": {"share": ("error", 1.0)},
    "drive_dead_band": {"half_width_V": ("width", 1.0)},
    "quadratic_drag": {"coefficient_N_m_s2_rad2": ("coefficient", 1.0)},
    "cable_spring": {"stiffness_N_m_rad": ("stiffness", 1.0)},
    "unbalance": {"cos_N_m": ("cosine", 1.0), "sin_N_m": ("sine", 1.0)},
    "load_dependent_friction": {"coefficient": ("coefficient", 1.0)},
    "base_vibration": {"frequency_Hz": ("frequency", 1.0)},
    "thermal_drift": {"time_constant_s": ("time_constant", 1.0)},
    "local_spot": {
        "height_N_m": ("height", 1.0),
        "place_deg": ("place", DEG),
        "sigma_deg": ("width", DEG),
    },
}
GYRO_NOISE = 0.05 * np.sqrt(30.0 / 500.0)  # deg/s, of the dual rigs' gyro below 30 Hz
GREY, BLUE = "0.45", "#0b3c6f"


class Truth(NamedTuple):
    """What a label says, whichever program wrote it."""

    must: set  # names that a right diagnosis has
    material: set  # names that it may have
    present: set  # names of all that is there
    unknown: bool  # something is on no list
    depends_on: set  # variables, one of which an unknown should have
    worth: dict  # mean square of the held-out error per thing: (name or None, above the floor)
    size: dict  # rise of the error over the floor, per name in `must`
    floor: float | None
    without: float | None  # error of the true rig without the effects
    parameters: dict


def truth_of(label):
    """A label of the rigs of this folder, or of a handed folder of any of the three kinds."""
    depends = set(label.get("depends_on_any_of") or label.get("depends_on") or [])
    parameters = label.get("parameters", label.get("effect_parameters", {}))
    if "things" not in label:
        listed = label["truth"] if "truth" in label else label["effects"]
        names = {n for n in listed if not n.startswith("unknown")}
        error = label.get("held_error_percent", {})
        unknown = bool(label.get("on_no_list")) or len(names) < len(listed)
        ends = error.get("floor"), error.get("without_the_effects")
        return Truth(names, names, names, unknown, depends, {}, {}, *ends, parameters)
    things = label["things"]
    named = [x for x in things.values() if x["name"]]
    if "held_error_percent" in label:
        error, key = label["held_error_percent"], "rise_percent"
        floor, without, noise = error["floor"], error["without_the_effects"], 0.0
    else:
        key, floor = "rise_speed_below_30_Hz_deg_s", label["floor_of_twins_deg_s"]
        without, noise = label.get("without_the_effects_deg_s"), GYRO_NOISE
    worth = {k: (x["name"], max(0.0, (x[key] + floor) ** 2 - floor**2)) for k, x in things.items()}
    if without is None:
        without = float(np.sqrt(floor**2 + sum(square for _, square in worth.values())))
    # What is measured has the gyro's noise, which no model predicts.
    floor, without = float(np.hypot(floor, noise)), float(np.hypot(without, noise))
    return Truth(
        must={x["name"] for x in named if x["main"] and x["material"]},
        material={x["name"] for x in named if x["material"]},
        present={x["name"] for x in named},
        unknown=bool(label.get("on_no_list")),
        depends_on=depends,
        worth=worth,
        size={x["name"]: x[key] / floor for x in named if x["main"]},
        floor=floor,
        without=without,
        parameters=parameters,
    )


def score(line):
    """Judgement of one line: outcome, names, verdict, probabilities, budget, predictions."""
    truth = truth_of(line["label"])
    judged = {
        "id": line["id"], "outcome": "refused", "right": [], "immaterial": [], "absent": [],
        "missed": sorted(truth.must), "true": sorted(truth.must), "unknown": truth.unknown,
        "verdict": "refused", "verdict_right": False, "stated": [], "budget_off": [],
        "covered": [], "left": None, "horizon": None, "over_floor": None, "worse": None,
        "size": truth.size, "seconds": line["seconds"],
    }  # fmt: skip
    said = line.get("diagnosis")
    if said is None:
        return judged
    names = {}
    for effect in said["effects"]:
        names.setdefault(true_name(effect, truth), effect)
    counted = {n for n, e in names.items() if e["probability"] >= COUNTS and n != "unknown"}
    judged |= {
        "right": sorted(counted & truth.material),
        "immaterial": sorted(counted & (truth.present - truth.material)),
        "absent": sorted(counted - truth.present),
        "missed": sorted(truth.must - counted),
        "verdict": said["verdict"],
        "verdict_right": said["verdict"] in right_verdicts(truth, counted),
        "stated": [
            (e["probability"], truth.unknown if n == "unknown" else n in truth.present)
            for n, e in names.items() if n != LEFT_OUT
        ],
        "covered": covered(said["effects"], truth.parameters),
        "budget_off": budget_off(said.get("budget", []), truth),
    }  # fmt: skip
    lost = bool(judged["missed"])
    if truth.unknown:
        found = {word for v in said.get("depends_on", []) for word in words(v)}
        lost = said["verdict"] != "unknown" or not found & truth.depends_on
    judged["outcome"] = (
        "missed" if lost
        else "absent" if judged["absent"]
        else "immaterial" if judged["immaterial"]
        else "right"
    )  # fmt: skip
    return judged | predictions(line.get("held"), truth)


def true_name(effect, truth):
    """The name, or its twin where that is what is there and stands beside it."""
    name = effect["name"]
    twin = TWINS.get(name)
    beside = twin in effect.get("confusable_with", [])
    return twin if name not in truth.present and twin in truth.present and beside else name


def words(variable):
    """theta_L and theta:motor are also a theta."""
    return {variable, variable.split(":")[0], re.split("[^A-Za-z]", variable)[0]}


def right_verdicts(truth, counted):
    """Verdicts that the contract allows, given what was named."""
    if truth.unknown:
        return {"unknown"}
    total = sum(square for _, square in truth.worth.values())
    if not truth.must and total == 0.0:
        return {"none"}
    share = float(not truth.must - counted)
    if total > 0.0:
        share = sum(square for name, square in truth.worth.values() if name in counted) / total
    least = {"none"} if not truth.must else set()
    return least | {"explained" if share >= EXPLAINED else "unknown"}


def covered(effects, parameters):
    """Whether each interval that claims 90 % holds the truth, where label and effect agree."""
    flags = []
    for effect in effects:
        truth = parameters.get(effect["name"], {})
        for theirs, (ours, factor) in SAME.get(effect["name"], {}).items():
            found = effect["parameters"].get(ours, {})
            if theirs in truth and found.get("se") is not None:
                flags.append(abs(found["value"] - factor * truth[theirs]) <= NINETY * found["se"])
    return flags


def budget_off(budget, truth):
    """|stated - true| share of the removable error, per row of the budget that is there."""
    total = sum(square for _, square in truth.worth.values())
    if total == 0.0:
        return []
    shares = Counter()
    for name, square in truth.worth.values():
        shares[name] += square / total
    rows = [row for row in budget if row.get("share") is not None and row["name"] in shares]
    return [abs(row["share"] - shares[row["name"]]) for row in rows]


def predictions(held, truth):
    """Free runs on logs never handed out: share of the effects' error left, and over the floor."""
    if not held or held["free"] is None or not truth.floor:
        return {}
    over = held["free"] / truth.floor
    reported = {"horizon": held["horizon"], "over_floor": over}
    if truth.without is None or truth.without < LEAST * truth.floor:
        return reported
    left = (held["free"] - truth.floor) / (truth.without - truth.floor)
    return reported | {"left": left, "worse": held["free"] > truth.without}


def clopper_pearson(hits, total, confidence=0.95):
    """Exact two-sided interval of a proportion."""
    if total == 0:
        return [0.0, 1.0]
    tail = (1 - confidence) / 2
    low = beta.ppf(tail, hits, total - hits + 1) if hits else 0.0
    high = beta.ppf(1 - tail, hits + 1, total - hits) if hits < total else 1.0
    return [float(low), float(high)]


def proportion(flags):
    flags = [bool(f) for f in flags]
    return {
        "hits": sum(flags),
        "of": len(flags),
        "interval": clopper_pearson(sum(flags), len(flags)),
    }


def spread(values):
    values = [float(v) for v in values if v is not None]
    if not values:
        return None
    shares = {"median": 0.5, "p90": 0.9, "max": 1.0}
    return {name: float(np.quantile(values, q)) for name, q in shares.items()} | {"of": len(values)}


def group(judged):
    """How much a rig lacks: the rows of the table."""
    return UNLISTED if judged["unknown"] else GROUPS[min(len(judged["true"]), 3)]


def summarise(scores):
    """All figures of a campaign, plain types."""
    stated = [tuple(s) for j in scores for s in j["stated"]]
    named = [(n, n in j["right"], j["size"].get(n)) for j in scores for n in j["true"]]
    sized = [(hit, size) for _, hit, size in named if size is not None]
    right = [j for j in scores if j["outcome"] == "right"]
    return {
        "rigs": len(scores),
        "outcomes": {
            g: Counter(j["outcome"] for j in scores if group(j) == g)
            for g in (*GROUPS, UNLISTED)
            if any(group(j) == g for j in scores)
        },
        "right": proportion(j["outcome"] in ("right", "immaterial") for j in scores),
        "false_on_nulls": proportion(j["absent"] for j in scores if group(j) == GROUPS[0]),
        "verdict": proportion(j["verdict_right"] for j in scores),
        "main_effects": proportion(hit for _, hit, _ in named),
        "absent_names": sum(len(j["absent"]) for j in scores),
        "false_beside_right": sum(len(j["absent"]) for j in scores if j["right"]),
        "by_effect": {
            name: proportion(hit for n, hit, _ in named if n == name)
            for name in sorted({n for n, *_ in named})
        },
        "by_size": {
            f"{low:g} to {high:g} x floor": proportion(hit for hit, s in sized if low <= s < high)
            for low, high in pairwise(SIZES)
        },
        "brier": float(np.mean([(p - ok) ** 2 for p, ok in stated])) if stated else None,
        "reliability": reliability(stated),
        "budget_off": spread(x for j in scores for x in j["budget_off"]),
        "covered": proportion(flag for j in scores for flag in j["covered"]),
        "error_left": spread(j["left"] for j in scores),
        "first_second": spread(j["horizon"] for j in scores),
        "worse_than_without": proportion(j["worse"] for j in scores if j["worse"] is not None),
        "over_floor_where_right": spread(j["over_floor"] for j in right),
        "seconds": spread(j["seconds"] for j in scores),
        "not_right": [
            {k: j[k] for k in ("id", "outcome", "missed", "absent", "immaterial", "verdict")}
            for j in scores
            if j["outcome"] != "right"
        ],
    }


def reliability(stated):
    """Per bin of stated probability: its mean, share right, 95 % interval, number."""
    if not stated:
        return []
    p, ok = np.array(stated, float).T
    place = np.clip(np.digitize(p, BINS) - 1, 0, len(BINS) - 2)
    rows = []
    for i in np.unique(place):
        mine = place == i
        hits, count = int(ok[mine].sum()), int(mine.sum())
        rows.append({"stated": float(p[mine].mean()), "right": hits / count, "of": count,
                     "interval": clopper_pearson(hits, count)})  # fmt: skip
    return rows


def report(summary):
    """The summary as a table for the terminal."""
    rows = [f"{'lacks':15s}" + "".join(f"{o:>11s}" for o in OUTCOMES) + f"{'of':>6s}"]
    for name, counts in summary["outcomes"].items():
        cells = "".join(f"{counts.get(o, 0):11d}" for o in OUTCOMES)
        rows.append(f"{name:15s}{cells}{sum(counts.values()):6d}")

    def row(title, p):
        if p["of"]:
            low, high = p["interval"]
            rows.append(f"{title:48s}{p['hits']:5d} of {p['of']:4d}   {low:.3f} to {high:.3f}")

    def line(title, s):
        if s:
            figures = f"median {s['median']:.3g}, nine of ten {s['p90']:.3g}, all {s['max']:.3g}"
            rows.append(f"{title:48s}{figures}, of {s['of']}")

    row("right, or something immaterial beside", summary["right"])
    row("main effects named", summary["main_effects"])
    row("a name on rigs that lack nothing", summary["false_on_nulls"])
    false = f"{summary['absent_names']:5d}; {summary['false_beside_right']}"
    rows.append(f"{'absent names; beside right ones':48s}{false}")
    row("verdict as the contract says", summary["verdict"])
    if summary["brier"] is not None:
        rows.append(f"{'Brier score over stated names':48s}{summary['brier']:.3f}")
    for b in summary["reliability"]:
        rows.append(f"  stated {b['stated']:.2f}: right {b['right']:.2f} of {b['of']}")
    line("budget: stated less true share", summary["budget_off"])
    line("held-out error left, share of the effects'", summary["error_left"])
    line("held-out error of the first second", summary["first_second"])
    row("held-out error worse than without the effects", summary["worse_than_without"])
    line("held-out error over floor, where right", summary["over_floor_where_right"])
    row("intervals of 90 % that hold the truth", summary["covered"])
    line("seconds", summary["seconds"])
    for title in ("by_size", "by_effect"):
        for name, p in summary[title].items():
            row(f"  {name}", p)
    for j in summary["not_right"]:
        extra = " ".join([*(f"-{n}" for n in j["missed"]), *(f"+{n}" for n in j["absent"]),
                          *(f"~{n}" for n in j["immaterial"])])  # fmt: skip
        rows.append(f"{j['id']:24s}{j['outcome']:11s}{j['verdict']:10s}{extra}")
    return "\n".join(rows)


def pictures(scores, summary, folder):
    """Write confusion.png and, where probabilities were stated, reliability.png."""
    for name, figure in (("confusion", confusion(scores)), ("reliability", calibration(summary))):
        if figure is not None:
            figure.savefig(folder / f"{name}.png", dpi=120)
            plt.close(figure)


def confusion(scores):
    """Rows: what is there. Columns: what is named for it."""
    pairs = Counter()
    for j in scores:
        wrong = list(j["absent"])
        for name in j["true"]:
            if name in j["right"]:
                pairs[name, name] += 1
            else:
                pairs[name, wrong.pop(0) if wrong else "nothing"] += 1
        if j["unknown"]:
            instead = wrong.pop(0) if wrong else "nothing"
            pairs[UNLISTED, "unknown" if j["outcome"] == "right" else instead] += 1
        if not j["true"] and not j["unknown"] and not wrong:
            pairs["nothing", "nothing"] += 1
        for name in wrong:
            pairs["nothing", name] += 1
    last = {"nothing": 1, UNLISTED: 2, "unknown": 2}
    rows, columns = (
        sorted(set(side), key=lambda n: (last.get(n, 0), n)) for side in zip(*pairs, strict=True)
    )
    table = np.array([[pairs[r, c] for c in columns] for r in rows])
    share = table / table.sum(axis=1, keepdims=True)
    size = (3.5 + 0.36 * len(columns), 2.6 + 0.3 * len(rows))
    figure, ax = plt.subplots(figsize=size, layout="constrained")
    ax.imshow(share, cmap="Greys", vmin=0, vmax=1.25, aspect="auto")
    for (i, j), n in np.ndenumerate(table):
        if n:
            color = "white" if share[i, j] > 0.6 else "black"
            ax.text(j, i, n, ha="center", va="center", color=color)
    ax.set_xticks(range(len(columns)), [n.replace("_", " ") for n in columns], rotation=90)
    ax.set_yticks(range(len(rows)), [n.replace("_", " ") for n in rows])
    ax.set(xlabel="named", ylabel="true", title="True effects and the names given")
    return figure


def calibration(summary):
    """Share that is right against stated probability."""
    bins = summary["reliability"]
    if not bins:
        return None
    figure, ax = plt.subplots(figsize=(5, 4), layout="constrained")
    ax.plot([0, 1], [0, 1], color=GREY, linestyle="--", label="perfect")
    for b in bins:
        (x, y), (low, high) = (b["stated"], b["right"]), b["interval"]
        ax.errorbar(x, y, [[y - low], [high - y]], fmt="o", color=BLUE, capsize=3)
        ax.annotate(f"{b['of']}", (x, y), xytext=(6, -12), textcoords="offset points")
    ax.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    ax.set(xlabel="stated probability", ylabel="share right, with 95 % interval")
    count = sum(b["of"] for b in bins)
    ax.set_title(f"Stated names: Brier score {summary['brier']:.3f}, {count} names")
    ax.legend(loc="upper left", frameon=False)
    return figure
