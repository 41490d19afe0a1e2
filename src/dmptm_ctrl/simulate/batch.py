"""Many drives at once: 16 per vector loop, such groups over the cores."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.simulate.any_model import at_rest, inputs_of, seen_of, steps_of
from dmptm_ctrl.simulate.compiled import BODIES, INPUTS, OUTPUTS, SEEN, SUBSTEPS, Loop, march
from dmptm_ctrl.simulate.dual import start
from dmptm_ctrl.simulate.lanes import LANES
from dmptm_ctrl.simulate.law import Law
from dmptm_ctrl.simulate.many import Common, run_many, same_shape
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.observer import rigid_observer
from dmptm_ctrl.simulate.plant import NO_ROWS, Plant
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.run import own_rows

BATCH_OUTPUTS = (*OUTPUTS, *INPUTS)
# Drives left over by full groups, which one after another take the plain loop less than lanes of
# which most are empty: these take as long as four or five, however many are in them.
ALONE = 4


class Batch(NamedTuple):
    """Runs of a batch."""

    time: Floats  # (m,) [s], of the kept samples
    outputs: Floats  # (batch, labels, m), SI
    labels: tuple[str, ...]  # names of the kept outputs
    least: Floats  # (batch, 10), over all samples, of all :data:`BATCH_OUTPUTS`; of rigs alike
    greatest: Floats
    mean: Floats
    rms: Floats


def march_any(
    models: Sequence[Model],
    u: Floats,
    x0: Floats,
    dt: float,
    *,
    substeps: int = SUBSTEPS,
    observer: tuple[float, float] | None = None,
    measured: Floats | None = None,
    begin: float = 0.0,
    columns: Sequence[int] = range(len(OUTPUTS)),
) -> Floats:
    """Run any number of drives open loop: :func:`~.compiled.march` for each, but faster.

    `u`, `x0` and `measured` are as there, of all or (batch, …) of each; the other numbers are of
    all; `columns` are those of :data:`~.compiled.OUTPUTS` to keep. Returns a (batch, n, columns)
    array. The scheme is the same; rounding differs.
    """
    inputs = np.ascontiguousarray(u if u.ndim == 3 else u[None])
    angles = None if measured is None else own_rows(measured)
    states = np.broadcast_to(x0, (len(models), 6))
    plants = [model.plant() for model in models]
    together, alone = _shared_out(plants)
    out = np.empty((len(models), len(columns), inputs.shape[2]))
    if together:
        kept = tuple(SEEN[OUTPUTS[c]] for c in columns)
        common = Common(
            dt, substeps, inputs.shape[2], inputs, np.zeros((1, 1)), NO_ROWS, kept, begin=begin
        )
        observers = None
        if observer is not None and angles is not None:
            common = common._replace(measured=angles[:, None])
            observers = [rigid_observer(plants[k], 0, observer) for k in together]
        starts = [start(plants[k], states[k]) for k in together]
        runs, _ = run_many(
            [models[k] for k in together], starts, common.of(together), observers=observers,
            switched=True,
        )  # fmt: skip
        if not alone:
            return np.asarray(runs).transpose(0, 2, 1)
        out[together] = runs
    for k in alone:
        volts = inputs[k if len(inputs) > 1 else 0]
        lead = None if angles is None else angles[k if len(angles) > 1 else 0]
        run = march(
            models[k], volts, states[k], dt, substeps=substeps, observer=observer, measured=lead,
            begin=begin, meshes=max(columns) >= BODIES,
        )  # fmt: skip
        out[k] = run.T[[*columns]]
    return out.transpose(0, 2, 1)


def _shared_out(plants: list[Plant]) -> tuple[list[int], list[int]]:
    """Which drives are to run beside each other, and which alone."""
    together: list[int] = []
    alone: list[int] = []
    for members, *_ in same_shape(plants):
        left = len(members) % LANES
        full = len(members) - (left if left <= ALONE else 0)
        together += members[:full]
        alone += members[full:]
    return sorted(together), alone


def simulate_batch(
    models: Sequence[Model | RigModel],
    timepts: ArrayLike,
    inputs: ArrayLike,
    initial_state: ArrayLike | None = None,
    *,
    loop: Loop | Law | Sequence[Loop] | Sequence[Law] | None = None,
    noise: ArrayLike | None = None,
    outputs: Sequence[str] = (),
    every: int = 1,
    substeps: int | None = None,
    jobs: int = -1,
) -> Batch:
    """Run many drives, open loop or each under its speed loop.

    Parameters
    ----------
    models : sequence of Model or of RigModel
        Rigs have the same inputs and sensors.
    timepts : (n,) array [s]
        Evenly spaced.
    inputs : (2, n) or (batch, 2, n) array [V]
        Left and right motor voltage, or the inputs of rigs [SI]; with `loop` the reference, (n,)
        or (batch, n) [rad/s].
    initial_state : (6,) or (batch, 6) array, optional
        As for :func:`~dmptm_ctrl.simulate.simulate`; rigs start from rest.
    loop : Loop, Law or sequence of either, optional
        One for all, or one for each. A designed controller gives ``controller.law()``; rigs take
        no other.
    noise : (n,) or (batch, n) array [rad/s], optional
        Added to the speed that the loop sees.
    outputs : sequence of str
        Names of outputs, as of :func:`~dmptm_ctrl.simulate.simulate`, and of inputs, to keep as
        signals; of rigs those of sensors and inputs. Without any only the statistics are kept.
    every : int
        Keep every so many samples.
    substeps : int, optional
        Steps per sample; by default of 125 µs, or what the fastest of rigs needs.
    jobs : int
        Threads, −1 for one per core, 1 for none; else joblib's, so ``parallel_config`` can send
        the groups to another backend.

    Returns
    -------
    Batch
        ``outputs`` (batch, labels, n) and their ``labels``; ``least``, ``greatest``, ``mean``,
        ``rms`` (batch, 10) over time, of all outputs and inputs.

    Raises
    ------
    ValueError
        Nothing to run, shapes that do not fit, an output that does not exist.

    Examples
    --------
    >>> time = np.arange(0.0, 1.0, 1e-3)
    >>> models = [dm.Model(dm.paper_drive().with_values(J_L=x)) for x in (2.4, 2.5, 2.6)]
    >>> runs = dm.simulate_batch(models, time, np.full((2, 1000), 0.6), outputs=["omega_L"])
    >>> runs.outputs.shape  # drives, outputs, samples
    (3, 1, 1000)
    """
    from dmptm_ctrl.simulate import _timepts

    time, dt = _timepts(timepts)
    n, count = time.size, len(models)
    if count == 0:
        raise ValueError("models is empty; needs at least one model")
    steps = max(steps_of(model, dt) for model in models) if substeps is None else substeps
    for name, number in (("every", every), ("substeps", steps)):
        if int(number) != number or number < 1:
            raise ValueError(f"{name} is {number!r}; needs a whole number of at least 1")
    seen, width = seen_of(models[0]), len(inputs_of(models[0]))
    for name in outputs:
        if name not in seen:
            raise ValueError(f"no output {name!r}; there are {', '.join(seen)}")
    drive, target = np.zeros((1, width, 0)), np.zeros((1, 1))
    measured = NO_ROWS
    loops: list[Loop | Law] | None = None
    if loop is None:
        drive = _rows("inputs", inputs, count, (width, n))
    else:
        target = _rows("inputs", inputs, count, (n,))
        if noise is not None:
            measured = _rows("noise", noise, count, (n,))
        loops = _loops(loop, count)
    if loops and any(isinstance(m, RigModel) for m in models) and isinstance(loops[0], Loop):
        raise ValueError("a Loop is of the dual-motor drive; rigs take a controller's law()")
    starts = [at_rest(model) for model in models]
    if initial_state is not None:
        if any(isinstance(model, RigModel) for model in models):
            raise ValueError("rigs start from rest; leave initial_state out")
        rows = np.broadcast_to(_rows("initial_state", initial_state, count, (6,)), (count, 6))
        starts = [start(model.plant(), x0) for model, x0 in zip(models, rows, strict=True)]
    wanted, summed = tuple(seen[name] for name in outputs), tuple(seen.values())
    common = Common(dt, steps, n, drive, target, measured, wanted, every, summed)
    kept, found = run_many(models, starts, common, loops, jobs=jobs)
    least, greatest, total, squares = np.array(found).transpose(1, 0, 2)
    return Batch(
        time[::every] if outputs else time[:0],
        np.asarray(kept),
        tuple(outputs),
        least,
        greatest,
        total / n,
        np.sqrt(squares / n),
    )


def _loops(loop: Loop | Law | Sequence[Loop] | Sequence[Law], count: int) -> list[Loop | Law]:
    each: list[Loop | Law] = [loop] * count if isinstance(loop, Loop | Law) else list(loop)
    if len(each) != count:
        raise ValueError(f"loop has {len(each)} entries for {count} models")
    if len({isinstance(one, Law) for one in each}) > 1:
        raise ValueError("loop mixes Loop and Law; give one kind")
    return each


def _rows(name: str, values: ArrayLike, count: int, shape: tuple[int, ...]) -> Floats:
    """Return (1 or batch, *shape), finite."""
    array = np.array(values, float)
    if array.shape == shape:
        array = array[None]
    if array.shape[1:] != shape or array.shape[0] not in (1, count):
        raise ValueError(
            f"{name} has shape {np.shape(values)}; needs {shape}, or {(count, *shape)} for "
            f"{count} models"
        )
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} holds a value that is not finite")
    return array
