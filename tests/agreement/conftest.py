"""Models and runs that the agreement tests share."""

import numpy as np
import pytest

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.linear import turning
from dmptm_ctrl.simulate.model import Model

DT = 1e-3  # s


def friction_names(drive):
    return [name for name in drive if name[:2] in ("T3", "TL", "B3", "BL")]


@pytest.fixture(scope="session")
def paper():
    return Model()


@pytest.fixture(scope="session")
def frictionless(paper):
    """The paper's drive with every friction torque zero."""
    return paper.with_values(**dict.fromkeys(friction_names(paper.drive), 0.0))


@pytest.fixture(scope="session")
def smooth(paper):
    """Steady turn under preload with a small modulation: closed meshes, no sticking."""
    x0, u0 = turning(paper, preload=0.6)
    time = DT * np.arange(121)
    wave = np.sin(2 * np.pi * 8.0 * time)
    return time, u0[:, None] + 0.2 * np.array([[1.0], [0.5]]) * wave, x0


@pytest.fixture(scope="session")
def lively():
    """Start from rest, reversals, both gaps crossed, voltages of opposite preload."""
    time = DT * np.arange(121)
    wave = 0.85 * np.sin(2 * np.pi * 6.0 * time)
    return time, wave + np.array([[0.15], [-0.15]]), np.zeros(6)


def visible_parameters(effect):
    """Amplitudes at about a tenth of their bound, those of a table a slope; shapes mid-bank."""
    return {
        p.name: p.bank[len(p.bank) // 2] if p.bank else (0.1 - 0.002 * max(0, j - 4)) * p.high
        for j, p in enumerate(effect.parameters)
    }


@pytest.fixture(params=CATALOGUE)
def visible(request, paper):
    """The paper's drive with one effect of the catalogue, clearly visible."""
    name = request.param
    return paper.with_effect(name, **visible_parameters(CATALOGUE[name]))


@pytest.fixture(scope="session")
def visible_values():
    return visible_parameters
