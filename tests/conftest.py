"""Which tests go to one worker under `pytest -n 2 --dist loadgroup`, and in which order.

Tests of one file stay together, and files that compile the same kernels: a slow fixture is
built, and a kernel compiled, once and not in each worker. The first two groups compile
different kernels; later ones find these in numba's cache. What takes long comes early, so that
both workers end together. xdist's own mark for this, `xdist_group`, does nothing under
pytest 9.2: there an item's id cannot be changed any more.
"""

import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
TOGETHER = {  # folder -> group
    "rigs": "rigs",
    "agreement": "loop",
    "engine": "lanes",
    "design": "lanes",
    "bad_logs": "bad_logs",
    "diagnosis": "diagnosis",
    "rig_files": "rig_files",
}
APART = ("test_notebooks.py",)  # each test is long by itself
ORDER = (
    *("rigs", "agreement", "engine", "design", "rig_files", "bad_logs", "paper", "identify"),
    *("diagnosis", "recovery", "test_notebooks.py"),
)


def scope(nodeid):
    """Name of the group in which a test goes to a worker; `nodeid` as pytest writes it."""
    file = nodeid.split("::")[0].removeprefix(f"{TESTS.name}/")
    return nodeid if file in APART else TOGETHER.get(file.split("/")[0], file)


# A process runs what it has just compiled by another rounding than what it finds compiled, on CPUs
# with 512-bit vectors: results are the same to the bit once the lanes are in the cache.
LANES = """
import numpy as np
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.model import Model
simulate_batch([Model()] * 40, np.arange(9) * 1e-3, np.zeros((2, 9)), jobs=1)
"""


def pytest_sessionstart(session):
    """Compile them while tests are collected, and wait before any of them runs."""
    if not hasattr(session.config, "workerinput") and not session.config.option.collectonly:
        session.config.lanes = subprocess.Popen([sys.executable, "-c", LANES])


def lanes_are_there(config):
    if (compiling := getattr(config, "lanes", None)) and compiling.wait() != 0:
        raise pytest.UsageError("the lanes do not compile")


def pytest_collection_finish(session):
    lanes_are_there(session.config)


@pytest.hookimpl(optionalhook=True)  # of xdist, before it hands out the first test
def pytest_xdist_node_collection_finished(node):
    lanes_are_there(node.config)


@pytest.hookimpl(optionalhook=True)  # of xdist
def pytest_xdist_make_scheduler(config, log):
    if config.getoption("dist") != "loadgroup":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return scope(nodeid)

    config.option.loadscopereorder = False  # the order is that of the tests
    return Together(config, log)


def pytest_collection_modifyitems(config, items):
    if hasattr(config, "workerinput"):  # of xdist
        first = {name: rank for rank, name in enumerate(ORDER)}
        items.sort(key=lambda i: first.get(i.path.relative_to(TESTS).parts[0], len(first)))
