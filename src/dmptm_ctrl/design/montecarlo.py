"""Monte-Carlo over plants: shares and quantiles with confidence bounds, resumable."""

import hashlib
import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binom

from dmptm_ctrl.design.aims import Aims, tracking
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.draws import DECLARED, one_plant
from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.any_model import AnyModel
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.model_file import model_text

CHUNK = 64  # plants per task: enough for the lanes, small enough to lose
CONFIDENCE = 0.95


class MonteCarlo(NamedTuple):
    """Tracking errors of a controller over drawn plants."""

    errors: Floats  # (count,) [deg/s]
    volts: Floats  # (count,) [V]

    def quantile(self, q: float, confidence: float = CONFIDENCE) -> tuple[float, float, float]:
        """Return (estimate, low, high) of a quantile [deg/s], bounds free of a distribution.

        Order statistics: the number of draws below the true quantile is binomial.
        """
        ordered = np.sort(self.errors)
        n = ordered.size
        tail = 0.5 * (1.0 - confidence)
        low, high = int(binom.ppf(tail, n, q)) - 1, int(binom.ppf(1.0 - tail, n, q))
        return (
            float(np.quantile(ordered, q)),
            float(ordered[low]) if low >= 0 else 0.0,
            float(ordered[high]) if high < n else np.inf,
        )


def monte_carlo(
    model: AnyModel,
    controller: Controller,
    count: int,
    *,
    uncertainty: float = DECLARED,
    effects: Sequence[AnyModel] = (),
    aims: Aims | None = None,
    seed: int = 0,
    jobs: int | None = None,
    folder: str | PathLike[str] | None = None,
) -> MonteCarlo:
    """Run a controller on many drawn plants.

    Parameters
    ----------
    model : Model or RigModel
    controller : Controller
    count : int
    uncertainty : float
        Share of the declared ranges that plants are drawn from: 1 for a declared model, 0.25
        for one fitted to logs.
    effects : sequence of Model
        Further models to draw around, in turn: the drive with one effect each, say.
    aims : Aims, optional
        Duty and noise.
    seed : int
        Plant k is the same whatever `count`, `jobs` or the backend.
    jobs : int, optional
        Processes, by default 1; under ``joblib.parallel_config(backend="dask")`` the same call
        runs on a cluster, and a worker that dies costs only the time of its chunks.
    folder : path, optional
        Keeps each finished chunk; the same call continues where it stopped.

    Returns
    -------
    MonteCarlo
        ``errors`` [deg/s] and ``volts`` [V], (count,).

    Raises
    ------
    ValueError
        No plants asked for, or a folder that holds another run.

    Examples
    --------
    >>> runs = dm.monte_carlo(dm.Model(), dm.Controller(5.0, 90.0, preload=0.3), 100)
    >>> np.quantile(runs.errors, 0.9)  # deg/s
    """
    if count < 1:
        raise ValueError(f"count is {count}; needs at least one plant")
    aims = aims or Aims()
    models = [model, *effects]
    tasks = [range(k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]
    kept = None if folder is None else Path(folder)
    if kept is not None:
        _claim(kept, _key(controller, models, aims, uncertainty, seed))
    files = {task: kept and kept / f"{task.start:06d}-{task.stop:06d}.npy" for task in tasks}
    done = {task: np.load(file) for task, file in files.items() if file and file.exists()}
    missing = [task for task in tasks if task not in done]
    work = ((controller, models, task, uncertainty, aims, seed) for task in missing)
    for task, result in zip(missing, each(_chunk, work, jobs), strict=True):
        done[task] = result
        if file := files[task]:
            part = file.with_suffix(".part.npy")
            np.save(part, np.array(result))
            part.replace(file)
    errors, volts = (np.concatenate([done[task][i] for task in tasks]) for i in (0, 1))
    return MonteCarlo(errors, volts)


def _chunk(
    controller: Controller,
    models: list[AnyModel],
    task: range,
    uncertainty: float,
    aims: Aims,
    seed: int,
) -> tuple[Floats, Floats]:
    plants = [one_plant(models[k % len(models)], uncertainty, seed, k) for k in task]
    return tracking(controller, plants, aims, seed=seed, jobs=1)


def _key(controller: Controller, models: list[AnyModel], aims: Aims, *numbers: float) -> str:
    """Fingerprint of all that the result depends on."""
    parts: list[Any] = [controller.to_toml(), *numbers, aims.duty.reference.tobytes(), aims.noise]
    parts += [aims.duty.sample_time, aims.duty.settling]
    parts += [model_text(model) for model in models]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part if isinstance(part, bytes) else repr(part).encode())
    return digest.hexdigest()


def _claim(folder: Path, key: str) -> None:
    """Mark a folder as that of one run; ValueError where it is another's."""
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / "run.json"
    if mark.exists() and json.loads(mark.read_text(encoding="utf-8"))["key"] != key:
        raise ValueError(f"{folder.name} holds another run; give a new folder")
    mark.write_text(json.dumps({"key": key}) + "\n", encoding="utf-8")
