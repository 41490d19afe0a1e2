"""An experiment inside the rig's limits, as CSV, C and Structured Text."""

import numpy as np
import pandas as pd
import pytest
from tests.export.native import needs_compiler, st_stepper, warns_of_nothing
from tests.export.test_plant import RIG, rig_model

from dmptm_ctrl.cli import main
from dmptm_ctrl.export.c_source import c_header, c_source
from dmptm_ctrl.export.experiment import Limits, experiment_program, read_signals, within
from dmptm_ctrl.export.native import Compiled
from dmptm_ctrl.export.st_source import st_source
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml
from dmptm_ctrl.simulate.rig_run import march

TIME = 1e-3 * np.arange(4000)
SWEEP = 1.2 * np.sin(2 * np.pi * 0.4 * TIME)
TABLE = pd.DataFrame({"time_s": TIME, "u_left_V": SWEEP + 0.2, "u_right_V": SWEEP - 0.2})


def test_keeps_speed_and_travel_and_wastes_little():
    free = simulate(Model(), TIME, TABLE[["u_left_V", "u_right_V"]].to_numpy().T).outputs
    limits = Limits(1.3, 0.5 * np.abs(free[1]).max(), 0.6 * np.abs(free[0]).max())
    found = within(TABLE, limits, model=Model())
    u = found[["u_left_V", "u_right_V"]].to_numpy().T
    after = np.hstack([u, np.zeros_like(u)])  # the drive coasts
    out = simulate(Model(), 1e-3 * np.arange(8000), after).outputs
    assert np.abs(u).max() <= limits.signal
    shares = np.abs(out[1]).max() / limits.speed, np.abs(out[0]).max() / limits.travel
    assert max(shares) <= 1.0
    assert max(shares) > 0.97
    clipped = np.clip(TABLE.u_left_V, -1.3, 1.3)
    factor = u[0] / clipped
    np.testing.assert_allclose(factor, factor[0], rtol=1e-12)  # the shape stays


def test_of_another_sample_time_it_is_held():
    found = within(TABLE, Limits(), sample_time=2.5e-3)
    np.testing.assert_allclose(np.diff(found.time_s), 2.5e-3)
    np.testing.assert_array_equal(found.u_left_V[:4], TABLE.u_left_V[[0, 2, 5, 7]])


def test_rig_of_another_shape(tmp_path):
    """What is written keeps the limits of the load, also when it coasts behind the end."""
    table = pd.DataFrame({"time_s": TIME[:900], "u_V": 6.0 * np.sin(np.pi * TIME[:900])})
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    table.to_csv(tmp_path / "planned.csv", index=False)
    limits = {"max-signal": 5.0, "max-speed": 0.5, "max-travel": 0.1}
    options = [x for name, value in limits.items() for x in (f"--{name}", str(value))]
    options += ["--model", str(tmp_path / "rig.toml"), "--out", str(tmp_path)]
    assert main(["experiment", str(tmp_path / "planned.csv"), *options]) == 0
    written = read_signals(tmp_path / "next_experiment.csv")
    u = np.append(written.u_V, np.zeros(900))[None]
    run = march(rig_model(), u, 1e-3)
    shares = np.abs(run.speed("load")).max() / 0.5, np.abs(run.position("load")).max() / 0.1
    assert np.abs(u).max() <= 5.0
    assert 0.97 < max(shares) <= 1.0
    driven = np.abs(run.position("load"))
    assert driven[900:].max() > driven[:900].max()  # the premise: it coasts on


@pytest.mark.parametrize("dt", [1e-3, 50e-3])
def test_a_load_that_coasts_long_keeps_its_limits(dt):
    """Of a rig with viscous friction only, also between slow samples."""
    slippery = {f"body.load.{name}": 0.0 for name in ("coulomb", "static")}
    slippery |= {"body.motor.coulomb": 0.0, "body.motor.viscous": 2e-4, "body.load.viscous": 0.02}
    model, time = rig_model().with_values(slippery), dt * np.arange(round(0.6 / dt))
    table = pd.DataFrame({"time_s": time, "voltage_V": 6.0 * np.sin(2 * np.pi * time)})
    limits = Limits(5.0, 1.0, 0.05)
    u = within(table, limits, model=model).voltage_V.to_numpy()
    held = np.append(np.repeat(u, round(dt / 0.5e-3)), np.zeros(80_000))  # 40 s more
    run = march(model, held[None], 0.5e-3)
    travel = np.abs(run.position("load"))
    assert abs(run.speed("load")[-1]) < 1e-3  # it has come to rest
    assert 0.97 < max(travel.max() / 0.05, np.abs(run.speed("load")).max() / 1.0) < 1.002
    assert travel[2 * 1200 :].max() > 1.5 * travel[: 2 * 1200].max()  # long after the end


@needs_compiler
def test_c_and_structured_text_give_the_samples_and_then_nothing(tmp_path):
    table = within(TABLE[:800], Limits(), sample_time=0.1)
    program = experiment_program(table)
    warns_of_nothing(tmp_path, program)
    text = st_source(program)
    assert pytest.importorskip("blark.parse").parse_source_code(text).exception is None
    block = st_stepper(text, [p.name for p in program.outputs])
    steps = Compiled(program), block
    for step in steps:
        rows = np.array([step() for _ in range(len(table) + 3)])
        np.testing.assert_array_equal(rows[: len(table), 0], table.u_left_V)
        np.testing.assert_array_equal(rows[: len(table), 1], table.u_right_V)
        np.testing.assert_array_equal(rows[:, 2], np.arange(len(rows)) < len(table))
        assert not rows[len(table) :].any()


@pytest.mark.parametrize("to", ["csv", "c", "st"])
@pytest.mark.parametrize(("source", "drive"), [("model.toml", Model()), ("rig.toml", rig_model())])
def test_command(source, drive, to, tmp_path):
    """What is written has the limits' signal at the sample time that was asked for."""
    table = TABLE if source == "model.toml" else TABLE[["time_s", "u_left_V"]]
    planned, out = tmp_path / "planned.csv", tmp_path / "out"
    table[:2000].to_csv(planned, index=False)
    text = RIG if source == "rig.toml" else to_toml(Model())
    (tmp_path / source).write_text(text, encoding="utf-8")
    options = ["--model", str(tmp_path / source), "--max-speed", "0.1", "--max-signal", "1"]
    options += ["--sample-time", "0.002", "--to", to, "--out", str(out)]
    assert main(["experiment", str(planned), *options]) == 0
    kept = within(read_signals(planned), Limits(1.0, 0.1), model=drive, sample_time=2e-3)
    program = experiment_program(kept, planned)
    own = {
        "csv": {"csv": kept.to_csv(index=False)},
        "c": {"c": c_source(program), "h": c_header(program)},
        "st": {"st": st_source(program)},
    }[to]
    assert {p.name for p in out.iterdir()} == {f"next_experiment.{end}" for end in own}
    for end, text in own.items():
        written = (out / f"next_experiment.{end}").read_text("utf-8")
        assert written == text
        assert end == "csv" or "planned.csv, SHA-256" in written
        assert end == "csv" or "Sample time: 0.002 s" in written
    assert "u_left [V]" in c_header(program)
    assert "(* [V]" in st_source(program)
    np.testing.assert_allclose(np.diff(kept.time_s), 2e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,u\n0,1\n1,2\n", "needs a column time_s"),
        ("time_s,u_V\n0,1\n1,nan\n2,1\n", "row 2: a value that is no finite number"),
        ("time_s,u_V\n0,1\n1,1\n3,1\n", "the times are not evenly spaced"),
        ("time_s,u_V\n0,1\n1,hello\n", "no readable table of signals"),
    ],
)
def test_bad_tables(text, message, tmp_path):
    file = tmp_path / "signals.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LogError, match=message):
        read_signals(file)


def test_limits_that_need_a_model_or_cannot_be_kept(tmp_path):
    with pytest.raises(LogError, match="a limit is not positive"):
        within(TABLE, Limits(signal=0.0))
    with pytest.raises(LogError, match="need a model"):
        within(TABLE, Limits(speed=1.0))
    with pytest.raises(LogError, match="1 signals, and the model has 2"):
        within(TABLE[["time_s", "u_left_V"]], Limits(speed=1.0), model=Model())
    pushed = Model().with_effect("unbalance", cosine=60.0)
    with pytest.raises(LogError, match="no signal of this shape keeps the limits"):
        within(TABLE, Limits(travel=1e-6), model=pushed)
