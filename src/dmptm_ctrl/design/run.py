"""What the command line calls: a model file in, a controller and how good it is out."""

import json
from collections.abc import Callable
from pathlib import Path

from dmptm_ctrl.design.tune import Tuned, tune_controller
from dmptm_ctrl.plots.control import plot_tuning
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import read_dual_model


def tune_file(
    model: Path, out: Path, *, uncertainty: float, plants: int, seed: int, jobs: int,
    refine: Callable[[Model], Model],
) -> Tuned:  # fmt: skip
    """Tune on a model file, refined; write controller.toml, tuning.json, tuning.png, or nothing."""
    try:
        drive = refine(read_dual_model(model))
        tuned = tune_controller(
            drive, uncertainty=uncertainty, plants=plants, seed=seed, n_jobs=jobs
        )
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
