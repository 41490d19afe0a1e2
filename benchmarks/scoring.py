"""Scores and figures from the lines of results.jsonl."""

from collections import Counter

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import beta

CONFIDENCE = 0.95
BINS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0])  # of stated probability
TWINS = {"current_lag": "drive_delay", "drive_delay": "current_lag"}  # one lag, two shapes
NINETY = 1.645  # standard errors of a two-sided interval of 90 %
DEG = np.pi / 180
# effect → name in the label: name in the product, and factor between their units
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
GREY = "0.45"
BLUE = "#0b3c6f"


def clopper_pearson(hits, total, confidence=CONFIDENCE):
    """Exact two-sided interval of a proportion."""
    if total == 0:
        return [0.0, 1.0]
    tail = (1 - confidence) / 2
    low = beta.ppf(tail, hits, total - hits + 1) if hits else 0.0
    high = beta.ppf(1 - tail, hits + 1, total - hits) if hits < total else 1.0
    return [float(low), float(high)]


def proportion(flags):
    flags = list(flags)
    hits = int(sum(flags))
    share = hits / len(flags) if flags else None
    return {
        "hits": hits,
        "of": len(flags),
        "share": share,
        "interval": clopper_pearson(hits, len(flags)),
    }


def names(line):
    return [effect["name"] for effect in line["effects"]]


def hit(line, effect):
    """Whether an entry of a verdict names what is there, or its twin with it in the set.

    The lookup table of an unknown is right where what is there is on no list.
    """
    if effect["name"] == "unknown":
        return line["kind"] == "unknown"
    if effect["name"] in line["truth"]:
        return True
    twin = TWINS.get(effect["name"])
    return twin in line["truth"] and twin in effect["confusable_with"]


def right(line):
    """Right name first; of a pair both and nothing extra; of nothing none."""
    if line["kind"] == "null":
        return line["verdict"] == "none"
    if line["kind"] == "unknown":
        depends = set(line.get("depends_on", [])) & set(line["truly_depends_on"])
        return line["verdict"] == "unknown" and bool(depends)
    if line["kind"] == "single":
        return bool(line["effects"]) and hit(line, line["effects"][0])
    return len(line["effects"]) == len(line["truth"]) and all(hit(line, e) for e in line["effects"])


def error_left(line, lowest="floor"):
    """Share of the effect's own error on hidden logs that the augmented model leaves.

    Above the noise, or above what the rig's twins leave to chance too.
    """
    hidden = line.get("hidden") or {}
    least = hidden.get(lowest)
    if line["kind"] == "null" or least is None:
        return None
    if hidden["before"] < 1.5 * least:  # the effect does not show in their speed
        return None
    return (hidden["after"] - least) / (hidden["before"] - least)


def covered(line):
    """Whether each interval that claims 90 % holds the truth, where label and effect agree."""
    flags = []
    for effect in line["effects"]:
        truth = line.get("true_parameters", {}).get(effect["name"], {})
        for theirs, (ours, factor) in SAME.get(effect["name"], {}).items():
            if theirs in truth and ours in effect["parameters"]:
                found = effect["parameters"][ours]
                off = abs(found["value"] - factor * truth[theirs])
                flags.append(off <= NINETY * found["se"])
    return flags


def best_trial(line):
    """Strongest candidate of the first round."""
    return max(line.get("trials", []), key=lambda t: t["gain"] + t["held_gain"], default=None)


def spread(values):
    """Quantiles of some numbers, for people to set thresholds by."""
    values = [v for v in values if v is not None]
    if not values:
        return None
    shares = {"min": 0.0, "median": 0.5, "p90": 0.9, "p95": 0.95, "max": 1.0}
    return {name: float(np.quantile(values, q)) for name, q in shares.items()} | {"of": len(values)}


def null_evidence(lines):
    """Best evidence of the whole catalogue on each rig that lacks nothing."""
    best = [best_trial(line) for line in lines if line["kind"] == "null"]
    best = [trial for trial in best if trial]
    return {
        "evidence": spread([t["gain"] + t["held_gain"] for t in best]),
        "gain": spread([t["gain"] for t in best]),
        "held_gain": spread([t["held_gain"] for t in best]),
        "names": dict(Counter(t["name"] for t in best).most_common()),
    }


def summarise(lines):
    """All figures of a campaign, plain types."""
    kinds = {kind: [x for x in lines if x["kind"] == kind] for kind in KINDS}
    stated = [(e["probability"], hit(x, e)) for x in lines for e in x["effects"]]
    strengths = sorted({s for x in kinds["single"] for s in x["strengths"].values()})
    return {
        "rigs": len(lines),
        "failed": [x["id"] for x in lines if x["verdict"] == "failed"],
        "right": {kind: proportion(map(right, some)) for kind, some in kinds.items()},
        "false_alarms": proportion(x["verdict"] not in ("none", "failed") for x in kinds["null"]),
        "null_best": null_evidence(lines),
        "by_strength": {
            f"{s:g}": proportion(right(x) for x in kinds["single"] if s in x["strengths"].values())
            for s in strengths
        },
        "by_effect": {
            name: proportion(right(x) for x in kinds["single"] if x["truth"] == [name])
            for name in sorted({x["truth"][0] for x in kinds["single"]})
        },
        "by_sensors": {
            sensors: proportion(right(x) for x in kinds["single"] if x["sensors"] == sensors)
            for sensors in ("all", "load")
        },
        "covered": proportion(flag for x in lines for flag in covered(x)),
        "brier": float(np.mean([(p - h) ** 2 for p, h in stated])) if stated else None,
        "held_out_ratio": spread(
            x["after"] / x["before"] for x in lines if x["kind"] != "null" and x["effects"]
        ),
        "hidden_error_left": spread(error_left(x) for x in lines),
        "hidden_error_left_above_chance": spread(error_left(x, "chance") for x in lines),
        "hidden_error_left_by_law": {
            f"{kind} {law}": spread(error_left(x) for x in lines if x["laws"].get(kind) == law)
            for kind in ("friction", "contact")
            for law in sorted({x["laws"][kind] for x in lines if x.get("laws")})
        },
        "seconds": spread(x["seconds"] for x in lines),
        "missed": [missed(x) for x in lines if not right(x)],
    }


KINDS = ("null", "single", "pair", "unknown")


def missed(line):
    trials = sorted(line.get("trials", []), key=lambda t: -t["gain"] - t["held_gain"])
    return {
        "id": line["id"],
        "truth": line["truth"],
        "verdict": line["verdict"],
        "named": names(line),
        "trials": [[t["name"], round(t["gain"], 1), round(t["held_gain"], 1)] for t in trials],
    }


def report(summary):
    """The summary as a table for the terminal."""
    rows = ["                      right    of   95 % interval"]

    def row(title, p):
        if p["of"]:
            low, high = p["interval"]
            rows.append(f"{title:22s}{p['hits']:5d} {p['of']:5d}   {low:.3f} to {high:.3f}")

    for kind, p in summary["right"].items():
        row(kind, p)
    for strength, p in summary["by_strength"].items():
        row(f"  strength {strength}", p)
    for sensors, p in summary["by_sensors"].items():
        row(f"  sensors {sensors}", p)
    for name, p in summary["by_effect"].items():
        row(f"  {name}"[:22], p)
    alarms = summary["false_alarms"]
    if alarms["of"]:
        high = alarms["interval"][1]
        rows.append(f"false alarms {alarms['hits']} of {alarms['of']} nulls, at most {high:.1%}")
    evidence = summary["null_best"]["evidence"]
    if evidence:
        rows.append(
            f"best evidence on nulls: median {evidence['median']:.1f}, max {evidence['max']:.1f}"
        )
    within = summary["covered"]
    if within["of"]:
        rows.append(f"intervals of 90 % that hold the truth: {within['hits']} of {within['of']}")
    if summary["brier"] is not None:
        rows.append(f"Brier score {summary['brier']:.3f}")
    if summary["hidden_error_left"]:
        rows.append(
            f"error left on hidden logs, median {summary['hidden_error_left']['median']:.3f}"
        )
        above = summary["hidden_error_left_above_chance"]
        if above:
            rows.append(f"  above what is chance  {above['median']:.3f} of {above['of']}")
        for law, left in summary["hidden_error_left_by_law"].items():
            if left:
                rows.append(f"  {law:21s} {left['median']:.3f} of {left['of']}")
    if summary["seconds"]:
        median, most, last = (summary["seconds"][key] for key in ("median", "p90", "max"))
        rows.append(
            f"seconds per rig, median {median:.0f}, nine of ten at most {most:.0f}, all {last:.0f}"
        )
    rows += [f"missed {m['id']}: {m['verdict']} {' '.join(m['named'])}" for m in summary["missed"]]
    return "\n".join(rows)


def figures(lines, summary, folder):
    """Write the figures that these lines have something for."""
    singles = [x for x in lines if x["kind"] in ("null", "single", "unknown")]
    drawn = {
        "confusion": (confusion, singles),
        "calibration": (
            calibration,
            [(e["probability"], hit(x, e)) for x in lines for e in x["effects"]],
        ),
        "strength": (by_strength, summary["by_strength"]),
        "null_evidence": (
            evidence_of_nulls,
            [x for x in lines if x["kind"] == "null" and x.get("trials")],
        ),
    }
    for name, (draw, data) in drawn.items():
        if data:
            figure = draw(data)
            figure.savefig(folder / f"{name}.png", dpi=120)
            plt.close(figure)


def confusion(lines):
    """Rows: what is there. Columns: what is named first."""

    def row_of(line):
        return {"null": "none", "unknown": "unknown"}.get(
            line["kind"], line["truth"][0] if line["truth"] else "none"
        )

    def column_of(line):
        if line["verdict"] in ("none", "failed"):
            return line["verdict"]
        return names(line)[0] if line["effects"] else "unknown"

    pairs = Counter((row_of(x), column_of(x)) for x in lines)
    last = {"none": 1, "unknown": 2, "failed": 3}
    every = sorted({n for pair in pairs for n in pair}, key=lambda n: (last.get(n, 0), n))
    rows = [n for n in every if any(r == n for r, _ in pairs)]
    table = np.array([[pairs[r, c] for c in every] for r in rows])
    share = table / table.sum(axis=1, keepdims=True)
    size = (3.5 + 0.36 * len(every), 2.6 + 0.3 * len(rows))
    figure, ax = plt.subplots(figsize=size, layout="constrained")
    ax.imshow(share, cmap="Greys", vmin=0, vmax=1.25, aspect="auto")
    for (i, j), n in np.ndenumerate(table):
        if n:
            ax.text(
                j, i, n, ha="center", va="center", color="white" if share[i, j] > 0.6 else "black"
            )
    ax.set_xticks(range(len(every)), [n.replace("_", " ") for n in every], rotation=90)
    ax.set_yticks(range(len(rows)), [n.replace("_", " ") for n in rows])
    ax.set(xlabel="named first", ylabel="true", title="Rigs by true and by named effect")
    return figure


def calibration(stated):
    """Share that is right against stated probability."""
    p, ok = np.array(stated, float).T
    figure, ax = plt.subplots(figsize=(5, 4), layout="constrained")
    ax.plot([0, 1], [0, 1], color=GREY, linestyle="--", label="perfect")
    place = np.clip(np.digitize(p, BINS) - 1, 0, len(BINS) - 2)
    for i in np.unique(place):
        mine = place == i
        low, high = clopper_pearson(int(ok[mine].sum()), int(mine.sum()))
        x, y = p[mine].mean(), ok[mine].mean()
        ax.errorbar(x, y, [[y - low], [high - y]], fmt="o", color=BLUE, capsize=3)
        ax.annotate(f"{mine.sum()}", (x, y), xytext=(6, -12), textcoords="offset points")
    ax.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    ax.set(xlabel="stated probability", ylabel="share right, with 95 % interval")
    ax.set_title(f"Named effects: Brier score {np.mean((p - ok) ** 2):.3f}, {len(p)} names")
    ax.legend(loc="upper left", frameon=False)
    return figure


def by_strength(shares):
    """Share of single effects named right against their strength."""
    figure, ax = plt.subplots(figsize=(5, 3.6), layout="constrained")
    for i, p in enumerate(shares.values()):
        low, high = p["interval"]
        y = p["share"]
        ax.errorbar(i, y, [[y - low], [high - y]], fmt="o", color=BLUE, capsize=4)
        ax.annotate(f"{p['hits']} of {p['of']}", (i, y), xytext=(8, -4), textcoords="offset points")
    ax.set_xticks(range(len(shares)), [f"{s}" for s in shares])
    ax.set(xlim=(-0.5, len(shares) - 0.2), ylim=(-0.03, 1.03))
    ax.set(xlabel="strength (1: typical)", ylabel="right name first, with 95 % interval")
    ax.set_title("One effect: named right, by strength")
    return figure


def evidence_of_nulls(lines):
    """Best evidence of the catalogue on each rig that lacks nothing."""
    best = sorted((best_trial(x) for x in lines), key=lambda t: t["gain"] + t["held_gain"])
    figure, ax = plt.subplots(figsize=(6, 0.9 + 0.24 * len(best)), layout="constrained")
    rows = np.arange(len(best))
    ax.barh(rows, [t["gain"] + t["held_gain"] for t in best], color="0.75", label="evidence")
    ax.plot([t["gain"] for t in best], rows, "|", color=BLUE, ms=9, mew=2, label="on fitted logs")
    ax.plot([t["held_gain"] for t in best], rows, "x", color="black", label="on held-out logs")
    ax.set_yticks(rows, [t["name"].replace("_", " ") for t in best], fontsize=7)
    ax.set(xlabel="fall of the weighted square", title="Nulls: best candidate of each rig")
    ax.legend(loc="lower right", frameon=False)
    return figure
