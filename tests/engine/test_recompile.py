"""A new effect costs its site alone; what is compiled is said."""

import gc
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from dmptm_ctrl.contract import Effect, Parameter
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE, register
from dmptm_ctrl.simulate import loading
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.dual import catalogue
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.plant import structure_of
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march as march_rig
from dmptm_ctrl.simulate.scalar import scalar_engine
from dmptm_ctrl.simulate.sites import acting

AXIS = """
name = "axis"
[body.table]
inertia = 0.01
[input.motor]
column = "u_V"
body = "table"
gain = "0.5 N m/V"
[sensor.angle]
column = "q_rad"
body = "table"
"""


@pytest.fixture
def own_effect():
    """An effect of a user's, as a notebook would register it; taken back afterwards."""

    @njit
    def spring(theta_L, omega_L, t, p):
        return -p.stiffness * theta_L

    class Spring(NamedTuple):
        stiffness: float

    yield Effect(
        name="own_spring",
        site="load",
        kernel=spring,
        parameters=(Parameter("stiffness", "N·m/rad", 0.0, 1e3, 1.0),),
        values=Spring,
        location="",
        source="",
        depends_on=("theta_L",),
        reveals="",
    )
    CATALOGUE.pop("own_spring", None)


def structure(plant):
    return structure_of(plant, switched=True, either=True)


def engine():
    """Module with the step of the drive that has all effects of the catalogue."""
    return scalar_engine(structure(Model().plant())).module


def sites():
    """Addresses of the functions of sites; 0 but of the motors and of the load."""
    plant = (
        Model().with_effect("unbalance", cosine=1.0).with_effect("back_emf", damping=1e-3).plant()
    )
    return acting(structure(plant), plant)[2].tolist()


def test_an_effect_changes_its_site_alone_and_taking_it_back_restores_it(own_effect):
    step, before = engine(), sites()
    register(own_effect)
    assert engine() is step
    assert [a == b for a, b in zip(sites(), before, strict=True)].count(False) == 1
    del CATALOGUE["own_spring"]
    assert sites() == before


def test_an_own_effect_acts_with_the_torque_that_it_says(own_effect):
    """On a ring gear of 2.5 kg·m² that turns with the pinions, all meshes open."""
    register(own_effect)
    n = Model().drive["N_2"]
    x0 = np.array([0.0, 0.0, 0.0, n, n, 1.0])
    stiff, soft = (
        march(Model().with_effect("own_spring", stiffness=k), np.zeros((2, 2)), x0, 1e-3)[1, 1]
        for k in (900.0, 400.0)
    )
    turned = 1e-3 * np.arange(2)
    assert soft - stiff == pytest.approx(500.0 * np.trapezoid(turned, turned) / 2.5, rel=0.05)


def test_says_once_that_it_compiles(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("DMPTM_CACHE_DIR", str(tmp_path))
    for expected in ("Compiling the simulator", ""):
        loading._LOADED.pop("test_of_the_message", None)
        module = loading.load("test_of_the_message", "answer = 42\n", "the simulator")
        assert module.answer == 42
        said = capsys.readouterr().err
        assert said.startswith(expected)
        assert bool(said) == bool(expected)


class Remains:
    """What only the garbage collector removes, where Python goes on to another thread."""

    def __init__(self):
        self.own = self

    def __del__(self):
        for _ in range(100):
            pass


@pytest.fixture
def busy_collector():
    """A garbage collector that interrupts all that makes objects, and threads that take turns."""
    every, before = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(1e-6)
    gc.set_threshold(50)
    yield
    sys.setswitchinterval(every)
    gc.set_threshold(*before)


@pytest.mark.usefixtures("busy_collector")
def test_threads_that_ask_at_once_for_the_catalogue_wait_for_one_that_makes_it(own_effect):
    threads = 4
    together = Barrier(threads)
    register(own_effect)  # nobody has asked for it

    def asked(_):
        for _ in range(100):
            Remains()
        together.wait()
        return catalogue()

    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(asked, range(threads)))
    assert all(one is found[0] for one in found)
    assert own_effect in found[0].effects


def test_same_engine_while_the_catalogue_is_the_same():
    model = Model()
    march(model, np.zeros((2, 3)), rest(model, 0.0), 1e-3)
    assert engine() is engine()


def test_drives_of_other_shapes_share_the_loops():
    """One motor in place of two: arrays of another size, none of another kind."""
    loops = loading.loops()
    drive = parse_rig(AXIS)
    dual, time = Model(), 1e-3 * np.arange(3)
    start = rest(dual, 0.0)
    simulate_batch([dual], time, np.zeros((2, 3)), initial_state=start)
    march(dual, np.zeros((2, 3)), start, 1e-3)
    before = loops.march.signatures, loops.march_lanes.signatures
    still = np.zeros(1), np.zeros(1)
    tables = np.zeros((1, 1, 3)), np.zeros((1, 3)), np.zeros((0, 0))
    run_many([RigModel(drive)], [still], Common(1e-3, 8, 3, *tables, ("reading0",)))
    march_rig(RigModel(drive), np.zeros((1, 3)), 1e-3)
    assert (loops.march.signatures, loops.march_lanes.signatures) == before
