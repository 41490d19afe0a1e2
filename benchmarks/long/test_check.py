"""How often a check is right, too long for CI: ``python -m pytest benchmarks/long``."""

import pytest

import check as bench


@pytest.mark.parametrize(
    ("sensors", "machines", "reruns", "seed"),
    [("all", 50, 4, 5708), ("load", 50, 4, 5707), ("rig", 20, 10, 581)],
)
def test_false_alarms_are_one_in_a_hundred_and_changes_are_found(sensors, machines, reruns, seed):
    runs, alarms, found, _ = bench.counted(machines, reruns, seed, sensors)
    assert runs == 200
    assert alarms <= 0.01 * runs
    assert all(count >= 0.95 * machines for count in found.values())
