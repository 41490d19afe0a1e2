"""What the command line calls: a model file in, a controller and how good it is out."""

import json
from collections.abc import Callable
from pathlib import Path

from dmptm_ctrl.design.aims import Aims
from dmptm_ctrl.design.duty import FASTEST, usual_duty
from dmptm_ctrl.design.rig_aims import rig_aims
from dmptm_ctrl.design.tune import Tuned, tune_controller
from dmptm_ctrl.plots.control import plot_tuning
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import read_model
from dmptm_ctrl.simulate.rig_model import RigModel


def tune_file(
    model: Path, out: Path, *, uncertainty: float, plants: int, seed: int, jobs: int,
    refine: Callable[[Model], Model] | None = None, input: str = "", sensor: str = "",
    limit: float | None = None, speed: float | None = None, sample_time: float = 1e-3,
) -> Tuned:  # fmt: skip
    """Tune on a model file, refined; write controller.toml, tuning.json, tuning.png, or nothing.

    `limit` of the input and largest `speed` of the duty are SI; `input` and `sensor` are of a rig.
    """
    for name, value in (("limit", limit), ("speed", speed)):
        if value is not None and not value > 0.0:
            raise LogError(f"--{name} {value:g}: must be positive")
    try:
        drive = read_model(model)
        if isinstance(drive, RigModel):
            if refine is not None:
                raise LogError(f"{model.name}: --logs is for the dual-motor drive; leave it out")
            drive.check()
            aims = rig_aims(drive, input, sensor, limit=limit, speed=speed, sample_time=sample_time)
        else:
            if input or sensor:
                raise LogError(
                    f"{model.name}: a dual-motor drive has one loop; leave --input, --sensor out"
                )
            drive = drive if refine is None else refine(drive)
            aims = Aims(limit=limit or Aims().limit, duty=usual_duty(sample_time, speed or FASTEST))
        tuned = tune_controller(
            drive, aims, uncertainty=uncertainty, plants=plants, seed=seed, jobs=jobs,
            input=input, sensor=sensor,
        )  # fmt: skip
    except LogError:
        raise  # names the file already
    except ValueError as error:
        raise LogError(f"{model.name}: {error}") from None
    with output_folder(out) as folder:
        tuned.controller.save(folder / "controller.toml")
        text = json.dumps(tuned.to_dict(), indent=2, allow_nan=False)
        (folder / "tuning.json").write_text(text + "\n", encoding="utf-8")
        figure = plot_tuning(tuned).get_figure(root=True)
        assert figure is not None
        figure.savefig(folder / "tuning.png", dpi=150)
    return tuned
