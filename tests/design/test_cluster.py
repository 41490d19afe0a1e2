"""The same call on a Dask cluster, one of whose workers is killed: nothing lost, same bits."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from joblib import parallel_config

from dmptm_ctrl.design.aims import Aims
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, Duty, sine
from dmptm_ctrl.design.montecarlo import CHUNK, monte_carlo
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.model import Model

distributed = pytest.importorskip("distributed", reason="needs the extra dask")
LOOP = Controller(10.0, 400.0, preload=0.5, inertia=1.0, friction=1.0)
AIMS = Aims(duty=Duty(np.concatenate([np.zeros(100), sine(8 * DEG, 2.0, 1.0)]), settling=0.1))
CHUNKS = 8


@pytest.fixture(scope="module")
def client():
    """Two workers, each a process with a nanny that starts it anew."""
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def transitions(client):
    """Steps of tasks that the scheduler has seen."""
    return client.run_on_scheduler(lambda dask_scheduler: dask_scheduler.transition_counter)


def test_a_batch_on_the_cluster(client):
    """Each group of lanes gets its own rows of the inputs, wherever it runs."""
    models = [Model().with_values(J_L=20.0 + k) for k in range(40)]
    time = np.arange(100) * 1e-3
    volts = np.random.default_rng(3).uniform(-4.0, 4.0, (40, 2, 100))
    here = simulate_batch(models, time, volts, outputs=["omega_L"], jobs=1)
    before = transitions(client)
    with parallel_config(backend="dask"):
        there = simulate_batch(models, time, volts, outputs=["omega_L"], jobs=-1)
    assert transitions(client) > before
    np.testing.assert_array_equal(there.outputs, here.outputs)
    np.testing.assert_array_equal(there.rms, here.rms)


def kill_one_at_work(client, folder, victim_state):
    """Once the first chunk is kept, kill a worker that has others in hand."""
    pids = client.run(os.getpid)
    while not any(folder.glob("*[0-9].npy")):
        time.sleep(0.002)
    busy = {worker: len(tasks) for worker, tasks in client.processing().items() if tasks}
    victim = max(busy, key=busy.get)
    os.kill(pids[victim], signal.SIGKILL)
    victim_state.update(
        pid=pids[victim], held=busy[victim], kept=len(list(folder.glob("*[0-9].npy")))
    )


@pytest.mark.long
def test_a_worker_is_killed_in_the_middle(client, tmp_path):
    drive, plants = Model(), CHUNKS * CHUNK
    here = monte_carlo(drive, LOOP, plants, aims=AIMS)
    victim_state = {}
    killer = threading.Thread(
        target=kill_one_at_work, args=(client, tmp_path, victim_state), daemon=True
    )
    killer.start()
    with parallel_config(backend="dask"):
        there = monte_carlo(drive, LOOP, plants, aims=AIMS, folder=tmp_path)
    killer.join()
    assert victim_state["held"] >= 1
    assert victim_state["kept"] < CHUNKS
    assert victim_state["pid"] not in client.run(os.getpid).values()
    np.testing.assert_array_equal(there.errors, here.errors)
    np.testing.assert_array_equal(there.volts, here.volts)
