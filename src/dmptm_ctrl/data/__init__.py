"""Logs that come with the package."""

from importlib.resources import files
from pathlib import Path

SETS = ("demo_rig", "null_rig", "axis")
RIG_TEMPLATE = Path(str(files(__name__).joinpath("rig_template.toml")))  # commented
PAPER_RIG = Path(str(files(__name__).joinpath("paper_3dof.toml")))  # the built-in model as a file
PAPER_9DOF = Path(str(files(__name__).joinpath("paper_9dof.toml")))  # shafts and wheels as bodies
BASELINE = Path(str(files(__name__).joinpath("baseline.toml")))  # the three-inertia model


def path(name: str) -> Path:
    """Folder of a bundled set of logs, with a README on their source and licence.

    demo_rig has an effect that the declared model lacks; null_rig has none; axis is a linear
    axis with its rig file. ValueError for another name.
    """
    if name not in SETS:
        raise ValueError(f"no bundled logs named {name!r}; there are {', '.join(SETS)}")
    return Path(str(files(__name__).joinpath(name)))
