"""The scorer on diagnoses written by hand."""

import json

import campaign
import pytest
from scoring import confusion, plt, report, score, summarise, truth_of


def thing(name, rise, main=False, material=True):
    return {"name": name, "main": main, "material": material,
            "rise_speed_below_30_Hz_deg_s": rise}  # fmt: skip


LABEL = {
    "floor_of_twins_deg_s": 0.1,
    "things": {
        "unbalance": thing("unbalance", 0.9, main=True),
        "cogging": thing("cogging", 0.0, material=False),
        "loop_lag": thing("current_lag", 0.2),
        "quantisation": thing(None, 0.0, material=False),
    },
    "parameters": {"unbalance": {"cos_N_m": 3.0}},
}
# Mean squares above the floor: (0.9 + 0.1)^2 - 0.1^2 and (0.2 + 0.1)^2 - 0.1^2.
WORTH = {"unbalance": 0.99, "current_lag": 0.08}


def effect(name, probability=0.9, beside=(), **parameters):
    values = {k: {"value": v, "se": 0.1, "unit": ""} for k, v in parameters.items()}
    return {"name": name, "probability": probability, "parameters": values,
            "confusable_with": list(beside)}  # fmt: skip


def judged(effects, verdict="explained", label=LABEL, **more):
    said = {"verdict": verdict, "effects": effects, "depends_on": []} | more
    line = {"id": "r1", "label": label, "seconds": 1.0, "diagnosis": said}
    return score(line | {"held": more.pop("held", None)})


@pytest.mark.parametrize(
    ("effects", "outcome"),
    [
        ([effect("unbalance")], "right"),
        ([effect("unbalance"), effect("current_lag")], "right"),
        ([effect("unbalance"), effect("drive_delay", beside=["current_lag"])], "right"),
        ([effect("unbalance"), effect("drive_delay")], "absent"),
        ([effect("unbalance"), effect("cogging")], "immaterial"),
        ([effect("unbalance"), effect("backlash")], "absent"),
        ([effect("unbalance"), effect("backlash", 0.4)], "right"),
        ([effect("unbalance", 0.4)], "missed"),
        ([effect("cogging")], "missed"),
        ([], "missed"),
    ],
)
def test_outcomes(effects, outcome):
    assert judged(effects)["outcome"] == outcome


def test_a_refusal_misses_everything():
    found = score({"id": "r1", "label": LABEL, "seconds": 1.0, "exit": 2})
    assert (found["outcome"], found["missed"]) == ("refused", ["unbalance"])


def test_a_verdict_is_explained_from_four_fifths_of_the_removable_error():
    assert judged([effect("unbalance")])["verdict_right"]  # 0.99 of 1.07
    assert not judged([effect("unbalance")], "unknown")["verdict_right"]
    assert judged([effect("current_lag")], "unknown")["verdict_right"]
    assert judged([], "unknown")["verdict_right"]
    assert not judged([], "none")["verdict_right"]
    null = {"floor_of_twins_deg_s": 0.1, "things": {}}
    assert judged([], "none", null)["verdict_right"]
    assert not judged([], "unknown", null)["verdict_right"]


def test_budget_and_intervals():
    budget = [
        {"name": "unbalance", "share": 0.8},
        {"name": "current_lag", "share": 0.1},
        {"name": "floor", "share": None},
    ]
    found = judged([effect("unbalance", cosine=3.3)], budget=budget)
    total = sum(WORTH.values())
    off = [abs(0.8 - WORTH["unbalance"] / total), abs(0.1 - WORTH["current_lag"] / total)]
    assert found["budget_off"] == pytest.approx(off)
    assert found["covered"] == [False]  # 3 standard errors away
    assert judged([effect("unbalance", cosine=3.1)])["covered"] == [True]


def test_predictions():
    """The effects' own error is sqrt(floor^2 + 0.99 + 0.08), the floor 0.1 and the gyro's noise."""
    floor = (0.1**2 + 0.05**2 * 30 / 500) ** 0.5
    line = {"id": "r1", "label": LABEL, "seconds": 1.0, "held": {"free": 0.2, "horizon": 0.1}}
    line["diagnosis"] = {"verdict": "explained", "effects": []}
    found = score(line)
    assert found["left"] == pytest.approx((0.2 - floor) / ((floor**2 + 1.07) ** 0.5 - floor))
    assert found["over_floor"] == pytest.approx(0.2 / floor)
    assert not found["worse"]
    line["held"]["free"] = None
    assert score(line)["left"] is None


def test_something_on_no_list():
    label = {"truth": [], "on_no_list": "sector", "depends_on_any_of": ["theta", "angle"]}
    right = judged([effect("unknown")], "unknown", label, depends_on=["theta:rotor"])
    assert (right["outcome"], right["verdict_right"]) == ("right", True)
    other = judged([effect("unknown")], "unknown", label, depends_on=["time"])
    assert other["outcome"] == "missed"
    assert judged([effect("cogging")], "explained", label)["outcome"] == "missed"
    named = judged([effect("cogging")], "unknown", label, depends_on=["theta_L"])
    assert named["outcome"] == "absent"


def test_labels_of_the_blind_logs():
    truth = truth_of({"effects": ["cogging", "unknown: a knock"], "sensors": "all"})
    assert (truth.must, truth.unknown) == ({"cogging"}, True)


def test_a_summary_counts():
    scores = [
        judged([effect("unbalance", 0.9), effect("backlash", 0.6)]),
        judged([effect("unbalance", 0.8), effect("sensor_delay", 0.9)]),
        judged([], "none", {"floor_of_twins_deg_s": 0.1, "things": {}}),
    ]
    found = summarise(scores)
    assert found["brier"] == pytest.approx((0.1**2 + 0.6**2 + 0.2**2) / 3)
    assert [b["of"] for b in found["reliability"]] == [1, 1, 1]
    assert found["outcomes"]["one"] == {"absent": 2}
    assert found["outcomes"]["nothing"] == {"right": 1}
    assert found["main_effects"]["hits"] == 2
    assert found["by_size"]["3 to 10 x floor"]["of"] == 2
    assert found["false_beside_right"] == 2
    assert "Brier" in report(json.loads(json.dumps(found)))
    figure = confusion(scores)
    assert figure.axes[0].get_ylabel() == "true"
    plt.close(figure)


def test_a_campaign_goes_on_where_it_stopped(tmp_path, monkeypatch):
    looked = []

    def examine(case, out, threads):
        looked.append(case.id)
        return {"id": case.id, "label": case.label, "seconds": 1.0, "exit": 2, "message": ""}

    (tmp_path / "labels.json").write_text(json.dumps({"a": LABEL, "b": LABEL}))
    monkeypatch.setattr(campaign, "examine", examine)
    cases = campaign.handed(tmp_path)
    campaign.run(cases[:1], tmp_path, 1, 1, show=looked.append)
    with (tmp_path / "results.jsonl").open("a") as file:
        file.write('{"id": "b", "lab')  # a stop in the middle of a line
    looked.clear()
    campaign.run(cases, tmp_path, 1, 1, show=lambda line: None)
    assert looked == ["b"]
    assert "refused" in campaign.summary_of(tmp_path)
    assert (tmp_path / "confusion.png").exists()


def test_speeds_are_compared_below_30_hz(tmp_path):
    """A sine of 5 Hz stays, one of 100 Hz goes; a position becomes a speed."""
    import numpy as np

    t = 1e-3 * np.arange(4000)
    slow, fast = np.sin(2 * np.pi * 5 * t), np.sin(2 * np.pi * 100 * t)
    np.testing.assert_allclose(campaign.speed(slow + fast, 1e-3, False)[500:-500],
                               slow[500:-500], atol=0.01)  # fmt: skip
    found = campaign.speed(slow, 1e-3, True)[500:-500]
    assert np.abs(found).max() == pytest.approx(2 * np.pi * 5, rel=0.01)
