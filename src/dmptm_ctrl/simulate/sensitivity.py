"""How a run changes with parameters, through contacts, stops and starts.

A small change of each parameter goes along with the run, so that its share is the derivative of
the scheme itself: to first order by the slopes of the step (`tangent_core`), and with branches
of its own where the run reaches or leaves a flank, stops or starts. Of effects nobody has written
down the slopes: they are written from the source of their kernels (`slopes`,
`tangent_site_core`). Where that cannot be had, or there are more than fifteen changes, each is
a run of its own beside the others in vector lanes.
All parameters moved the other way together go along too: where the run is differentiable they
change minus the sum of the others, and where that is not so the derivative from one side is not
that from the other and does not exist. A derivative converges with the first order of the step
where events lie before it, the run itself with the second.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.contract import SITES, Effect
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.batch import march_many
from dmptm_ctrl.simulate.compiled import OUTPUTS, SUBSTEPS, rest
from dmptm_ctrl.simulate.compose import engine, layout, per_catalogue
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats, Model, Stacked
from dmptm_ctrl.simulate.slope_chains import deciding_fields

# Share of a parameter's size: truncation and rounding, grown by the run, are both far below 1 %
STEP = 1e-7
DIFFERENT = 0.02  # derivatives from both sides that differ by more are not the same
FEW = 2  # parameters that each go alone beside a run; more go as a vector
GROUP = 15  # parameters that go along with one run
# What no slope is known of may not move, and acts as here: no stiffness that varies with the
# teeth, friction falling exponentially
NEUTRAL = {
    BASE.index(name): value for name, value in (("k_a", 0.0), ("delta3", 1.0), ("deltaL", 1.0))
}
LEFT_ALONE = [*NEUTRAL] + [BASE.index(name) for name in ("N_1", "N_2", "z_3", "phi_r")]
# Sites: what none in use needs is not compiled in, for it would take time
KINDS = (
    *("motor", "mesh", "friction", "load", "delay", "lag", "shaft", "sensor_delay", "ageing"),
    "presliding",
)
WITH_MESHES, WITH_PRESLIDING = (KINDS.index(site) for site in ("mesh", "presliding"))
VARIED = BASE.index("k_a")  # not zero, the meshes' stiffness varies with the teeth
# Parameters that go along for less than lanes would take where a step of presliding is made for
# each, because it moves numbers of friction laws, or masses
FEW_WITH_STEPS = 2
OF_STEPS = ("J_", "T3", "TL", "B3_", "BL_", "W3", "WL")  # what their names begin with
BY_STEPS = frozenset(k for k, name in enumerate(BASE) if name.startswith(OF_STEPS))
EXPONENTS = [BASE.index(name) for name in ("delta3", "deltaL")]
UNKNOWN_SLOPES = frozenset(EXPONENTS) | {BASE.index(name) for name in ("N_1", "N_2")}
NOISE = 1e-4  # of an output's range per parameter's size, below which a difference is rounding


class Sensitivities(NamedTuple):
    """A run and its derivatives.

    Attributes
    ----------
    time : (n,) array [s]
    outputs : (8, n) array
        Of the run, in the order of :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS`.
    parameters : tuple of str
    derivatives : (p, 8, n) array
        ∂output/∂parameter, SI.
    exists : (8, n) array of bool
        False where the run is not differentiable: the derivatives from the two sides differ.
    """

    time: Floats
    outputs: Floats
    parameters: tuple[str, ...]
    derivatives: Floats
    exists: NDArray[np.bool_]


class _Place(NamedTuple):
    """Where a parameter stands in the arrays of a model, and how far it is moved."""

    slot: int  # of the drive's numbers, or of the effects'
    step: float
    effect: str  # or "" for the drive

    def move(self, rows: Stacked, row: int, ways: float = 1.0) -> None:
        """Move the parameter by some steps in one of the rows."""
        if not self.effect:
            rows.base[row, self.slot] += ways * self.step
            return
        rows.values[row, self.slot] += ways * self.step
        number, first = layout()[self.effect]
        parameters = CATALOGUE[self.effect].parameters
        values = rows.values[row, first : first + len(parameters)]
        acts = (x and not p.bank for p, x in zip(parameters, values, strict=True))
        rows.on[row, number] = any(acts)


def _place(model: Model, name: str, values: Floats) -> _Place:
    """Where a parameter is; `values` are those of all effects."""
    effect, _, parameter = name.rpartition(".")
    if not effect:
        if parameter not in model.drive:
            raise ValueError(f"the drive has no parameter {parameter!r}")
        value = model.drive[parameter]
        if value == 0.0:
            raise ValueError(f"{parameter} is zero: its size is not known; give it a value")
        return _Place(BASE.index(parameter), STEP * abs(value), "")
    names = [p.name for p in CATALOGUE[effect].parameters] if effect in CATALOGUE else []
    if parameter not in names:
        raise ValueError(f"no parameter {name!r}; effects are named as in 'cogging.left_cosine'")
    found = CATALOGUE[effect].parameters[names.index(parameter)]
    index = layout()[effect][1] + names.index(parameter)
    step = STEP * max(abs(values[index]), found.step)
    if values[index] - step < found.low:
        raise ValueError(f"{name} is at its lower bound {found.low:g}: no derivative from below")
    return _Place(index, step, effect)


def simulate_with_sensitivities(
    model: Model,
    timepts: ArrayLike,
    inputs: ArrayLike,
    parameters: Sequence[str],
    initial_state: ArrayLike | None = None,
    *,
    substeps: int = SUBSTEPS,
    jobs: int = 1,
) -> Sensitivities:
    """Run a drive open loop together with its derivatives with respect to parameters.

    Parameters
    ----------
    model : Model
    timepts, inputs, initial_state, substeps
        As for :func:`~dmptm_ctrl.simulate.simulate`; the initial state does not depend on
        the parameters.
    parameters : sequence of str
        Names of the drive's parameters, or "effect.parameter".
    jobs : int
        Threads, for more than fifteen parameters.

    Returns
    -------
    Sensitivities

    Raises
    ------
    ValueError
        No parameter of that name, or one whose size or range leaves no room for a difference.
    """
    from dmptm_ctrl.simulate import _finite, _timepts

    time = _timepts(timepts)
    u = _finite("inputs", inputs, (2, time.size), "left and right voltage at each time point")
    x0 = (
        rest(model, 0.0)
        if initial_state is None
        else _finite("initial_state", initial_state, (6,), "three angles and their speeds")
    )
    if len(parameters) == 0:
        raise ValueError("parameters is empty; name at least one")
    here = model.arrays()
    places = [_place(model, name, here[2]) for name in parameters]
    dt = (time[-1] - time[0]) / (time.size - 1)
    loop = _way(here, places)
    if loop is not None:
        groups = [places[k : k + GROUP] for k in range(0, len(places), GROUP)]
        tasks = [(loop, here, group, u, x0, dt, substeps) for group in groups]
        if len(tasks) == 1:
            parts = [_along(*tasks[0])]
        else:
            parts = list(each(_along, tasks, jobs, prefer="threads"))
        outputs, derivatives, exists = parts[0]
        if len(parts) > 1:
            derivatives = np.concatenate([part[1] for part in parts])
            exists = np.logical_and.reduce([part[2] for part in parts])
        return Sensitivities(time, outputs, tuple(parameters), derivatives, exists)
    steps = np.array([place.step for place in places])
    runs = march_many(_drives(here, places), u, x0, dt, substeps=substeps, jobs=jobs).transpose(
        0, 2, 1
    )
    outputs, changes = runs[0], runs[1:] - runs[0]
    derivatives = changes[:-1] / steps[:, None, None]
    exists = _existing(outputs, derivatives, changes[-1], steps, 0)
    return Sensitivities(time, outputs, tuple(parameters), derivatives, exists)


def _drives(arrays: Arrays, places: Sequence[_Place]) -> Stacked:
    """Numbers of a model, with each parameter moved, with all of them moved the other way."""
    base, on, values = arrays
    many = len(places) + 2
    copies = base[None].repeat(many, 0), on[None].repeat(many, 0), values[None].repeat(many, 0)
    rows = Stacked(*copies)
    for j, place in enumerate(places):
        place.move(rows, 1 + j)
        place.move(rows, -1, -1.0)
    return rows


def _plain(arrays: Arrays, places: Sequence[_Place]) -> bool:
    """Whether no effect acts and nothing moves but what `tangent_core` knows the slopes of."""
    base, on, _ = arrays
    known = not any(place.effect or place.slot in LEFT_ALONE for place in places)
    return known and not on.any() and all(base[slot] == x for slot, x in NEUTRAL.items())


class _Known(NamedTuple):
    """What of the effects of a catalogue is the same in all runs."""

    deciding: dict[str, frozenset[int] | None]
    sites: list[int]  # of each number, by its position in the contract
    kinds: NDArray[np.uint8]  # (kinds, effects), whether an effect is at a site of a kind


@per_catalogue
def _known(effects: tuple[Effect, ...]) -> _Known:
    return _Known(
        {effect.name: deciding_fields(effect) for effect in effects},
        [SITES.index(effect.site) for effect in effects for _ in effect.parameters],
        np.array([[effect.site == site for effect in effects] for site in KINDS], np.uint8),
    )


@per_catalogue
def _needed(_: tuple[Effect, ...], varied: bool, *used: int) -> tuple[bool | None, ...]:
    """Per kind of sites whether the loop needs it, for effects by their positions."""
    count = _known().kinds[:, list(used)].sum(axis=1)
    count[WITH_MESHES] += varied
    return tuple(True if some else None for some in count)


def _way(arrays: Arrays, places: Sequence[_Place]) -> Callable[..., int] | None:
    """Loop that takes changes along with a run, or None where each is to be a run of its own."""
    if _plain(arrays, places):
        return _by_slopes
    base, on, _ = arrays
    own = [p.slot for p in places if not p.effect]
    if any(base[slot] != 1.0 for slot in EXPONENTS) or not UNKNOWN_SLOPES.isdisjoint(own):
        return None
    known = _known()
    stepped = not BY_STEPS.isdisjoint(own) and bool((known.kinds[WITH_PRESLIDING] & on).any())
    few = FEW_WITH_STEPS if stepped else GROUP
    return _by_kernels if len(places) <= few and _smooth(on, places, known.deciding) else None


def _smooth(
    on: NDArray[np.uint8],
    places: Sequence[_Place],
    deciding: Mapping[str, frozenset[int] | None],
) -> bool:
    """Whether the slopes of all effects in use are known, and nothing moves that decides."""
    names = list(deciding)
    if any(deciding[names[k]] is None for k in on.nonzero()[0]):
        return False
    for place in places:
        if place.effect:
            found = deciding[place.effect]
            if found is None or place.slot - layout()[place.effect][1] in found:
                return False
    return True


class _Moved(NamedTuple):
    """Changes and numbers of the effects that these move, by site."""

    rows: NDArray[np.int64]  # (3, …) behind where each site begins
    places: tuple[NDArray[np.int64], NDArray[np.int64]]  # change and number of each


@per_catalogue
def _moved(_: tuple[Effect, ...], *slots: int) -> _Moved:
    """Of each change the number of an effect, -1 of a change of the drive's numbers."""
    sites, ends = _known().sites, len(SITES) + 1
    found = sorted((sites[slot], j, slot) for j, slot in enumerate(slots) if slot >= 0)
    begins = [(ends + sum(site < at for site, _, _ in found), 0, 0) for at in range(ends)]
    rows = np.array([*begins, *((0, j, slot) for _, j, slot in found)], np.int64)
    rows = np.ascontiguousarray(rows.T)
    return _Moved(rows, (rows[1, ends:], rows[2, ends:]))


def _by_kernels(
    given: tuple[Any, ...],
    drives: Stacked,
    places: Sequence[_Place],
    steps: Floats,
    results: Sequence[Floats],
) -> int:
    """Go along by `tangent_site_core`; the sample from which the other way is another one."""
    bases, values, loop = drives.base, drives.values, engine()
    moved = _moved(*(place.slot if place.effect else -1 for place in places))
    fixed, room = np.zeros((len(drives), loop.FIXED)), np.zeros((3, loop.STATE))
    first, own = loop.R_MOVES + len(SITES) + 1, values[1:-1] - values[0]
    s, r = np.zeros(loop.SIZE_WITH_SITES), np.zeros(first + moved.places[0].size)
    on = np.bitwise_or.reduce(drives.on)
    r[: loop.R_VALUES], r[loop.R_VALUES : loop.R_OWN] = on, values[0]
    r[first:] = own[moved.places]
    kinds = _needed(bool(bases[:, VARIED].any()), *on.nonzero()[0].tolist())
    return int(
        loop.march_site_tangents(
            *given, bases, values, on, moved.rows, steps, s, fixed, room, r, *results, *kinds
        )
    )


def _by_slopes(
    given: tuple[Any, ...],
    drives: Stacked,
    _: Sequence[_Place],
    steps: Floats,
    results: Sequence[Floats],
) -> int:
    """The same by `tangent_core`."""
    many = None if steps.size <= FEW else True  # two loops, compiled as they are needed
    return int(engine().march_tangents(*given, drives.base, steps, *results, many))


def _along(
    loop: Callable[..., int],
    arrays: Arrays,
    places: Sequence[_Place],
    u: Floats,
    x0: Floats,
    dt: float,
    substeps: int,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Outputs of a run, its derivatives and where they exist, by one of two loops."""
    n = u.shape[1]
    outputs, back = np.empty((len(OUTPUTS), n)), np.empty((len(OUTPUTS), n))
    derivatives = np.empty((len(places), len(OUTPUTS), n))
    steps = np.array([place.step for place in places])
    results = outputs, derivatives, back
    split = loop((u, x0, dt, substeps), _drives(arrays, places), places, steps, results)
    return outputs, derivatives, _existing(outputs, derivatives, back, steps, split)


def _existing(
    outputs: Floats, derivatives: Floats, back: Floats, steps: Floats, split: int
) -> NDArray[np.bool_]:
    """Where derivatives exist; `back` is what changes from sample `split` on the other way."""
    exists = np.ones(outputs.shape, np.bool_)
    if split < outputs.shape[1]:
        rounding = NOISE * STEP * np.ptp(outputs, axis=1) * steps.size
        _judge(derivatives, back, steps, rounding, DIFFERENT, split, exists)
    return exists


@cached(nogil=True)
def _judge(derivatives, back, steps, rounding, different, split, exists):
    """From sample `split` on, where one side says the same as the other."""
    p, rows, n = derivatives.shape
    for row in range(rows):
        for i in range(split, n):
            together, size = back[row, i], abs(back[row, i])
            for k in range(p):
                change = derivatives[k, row, i] * steps[k]
                together += change
                size += abs(change)
            exists[row, i] = abs(together) <= different * size + rounding[row]
