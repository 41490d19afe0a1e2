"""The selection on linear evidence with known noise, where every step is computed by hand."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.candidate import LEVEL, Candidate, Rows, differ
from dmptm_ctrl.diagnosis.confirmed import confirmed, contradicted, held_size, size_text
from dmptm_ctrl.diagnosis.select import (
    TEMPERATURE,
    Entry,
    Selection,
    best_of,
    compared,
    explained,
    pruned,
    select_effects,
)

ROWS, HELD = 400, 200


@dataclass(frozen=True, eq=False)
class Model:
    """Least squares of some columns on the fitted rows."""

    data: "Linear"
    keys: tuple[str, ...] = ()

    @cached_property
    def basis(self):
        return np.column_stack([np.ones(ROWS), *(self.data.x[k] for k in self.keys)])

    @cached_property
    def values(self):
        return np.linalg.lstsq(self.basis, self.data.y, rcond=None)[0]

    @property
    def held_missed(self):
        there = np.column_stack([np.ones(HELD), *(self.data.held_x[k] for k in self.keys)])
        return self.data.held_y - there @ self.values

    @property
    def missed(self):
        """Squares of the held-out rows."""
        return self.held_missed**2

    @property
    def target(self):
        return self.data.y - self.basis @ self.values

    @property
    def squares(self):
        """−2 log-likelihood of unit noise, on the fitted and the held-out rows."""
        return float(self.target @ self.target), float(self.missed.sum())

    def project(self, columns):
        return columns - self.basis @ np.linalg.lstsq(self.basis, columns, rcond=None)[0]


class Linear:
    """Evidence of columns beside a constant; objections by name."""

    def __init__(self, x, y, held_x, held_y, objections=()):
        self.x, self.y, self.held_x, self.held_y = x, y, held_x, held_y
        self.objections = dict(objections)
        self.impossible = {}  # effects that others make impossible

    def objection(self, without, state, key):
        return "impossible" if self.impossible.get(key) in state.keys else ""

    def candidate(self, state, keys):
        there = Model(self, (*state.keys, *keys))
        said = next((self.objections[k] for k in keys if k in self.objections), "")
        said = said or "".join(self.objection(state, there, k) for k in keys)
        error = float(np.sqrt(HELD * np.var(state.missed - there.missed)))
        return Candidate(tuple(keys), *self.gains(state, there), there, said, held_error=error)

    def candidates(self, state, only=None):
        names = self.x if only is None else only
        return [self.candidate(state, (k,)) for k in names if k not in state.keys]

    def gains(self, smaller, larger):
        pairs = zip(smaller.squares, larger.squares, strict=True)
        return tuple(a - b for a, b in pairs)

    def errors(self, smaller, larger):
        return 0.0, 0.0  # of rows whose scatter is known

    def held_residuals(self, smaller, larger):
        return smaller.held_missed, larger.held_missed

    def ratio(self, state):
        return ROWS / HELD

    def columns(self, state, candidate):
        return state.project(np.column_stack([self.x[k] for k in candidate.keys]))

    def rows(self, state, candidates):
        columns = {c.keys: -np.column_stack([self.x[k] for k in c.keys]) for c in candidates}
        free = np.full(state.basis.shape[1], np.inf)
        return Rows(state.target, -state.basis, -free, free, columns)

    def together(self, state, candidates):
        return self.candidate(state, [k for c in candidates for k in c.keys])

    def adopt(self, state, candidate):
        return Model(self, (*state.keys, *candidate.keys))

    beside = adopt  # least squares are fitted to the end at once

    def closed(self, state):
        return state

    def without(self, state, key):
        return Model(self, tuple(k for k in state.keys if k != key))

    def wald(self, state, key):
        j = 1 + state.keys.index(key)
        covariance = np.linalg.inv(state.basis.T @ state.basis)
        return float(state.values[j] ** 2 / covariance[j, j])

    def share(self, without, state, key):
        j = 1 + state.keys.index(key)
        return without.project(state.basis[:, j] * state.values[j])


def drawn(seed, made, true, *, names=10, flip=1.0, objections=()):
    """Linear evidence: independent columns, some `made` of others, and noise of one.

    `true` maps a name to its value; on the held-out rows it is `flip` times that.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for rows, sign in ((ROWS, 1.0), (HELD, flip)):
        x = {f"x{i}": rng.standard_normal(rows) for i in range(names)}
        x |= {key: recipe(x, rng.standard_normal(rows)) for key, recipe in made.items()}
        y = sign * sum((v * x[k] for k, v in true.items()), np.zeros(rows))
        parts += [x, y + rng.standard_normal(rows)]
    return Linear(*parts, objections)


def selected(data):
    return select_effects(data, Model(data))


def keys(selection):
    return {entry.key for entry in selection.entries}


@pytest.mark.parametrize("seed", range(5))
def test_one_effect(seed):
    data = drawn(seed, {}, {"x3": 0.6})
    found = selected(data)
    assert keys(found) == set(found.final.keys) == {"x3"}
    (entry,) = found.entries
    # the fall of the squares by simple regression: n r² var y
    own = data.x["x3"] - data.x["x3"].mean()
    reported = float(own @ data.y) ** 2 / float(own @ own)
    assert entry.gain == pytest.approx(reported, rel=1e-9)
    assert entry.probability > 0.99
    assert len(found.first) == len(data.x)
    assert "x3" not in {c.keys[0] for c in found.rest}


@pytest.mark.parametrize("seed", range(30))
def test_a_null_stays_null(seed):
    found = selected(drawn(seed, {}, {}, names=30))
    assert found.entries == []
    assert found.final is found.base
    assert found.path == []


@pytest.mark.parametrize("seed", range(5))
def test_effects_that_hide_each_other_are_found_as_a_pair(seed):
    """x1 and its near twin, in opposite directions: alone each is worth a hundredth."""
    data = drawn(seed, {"twin": lambda x, e: x["x1"] + 0.1 * e}, {"x1": 8.0, "twin": -8.0})
    alone = [c for c in data.candidates(Model(data)) if c.keys[0] in ("x1", "twin")]
    assert not any(c.acceptable for c in alone)
    found = selected(data)
    assert keys(found) == {"x1", "twin"}
    assert found.path[0].startswith("+ ")
    assert "x1" in found.path[0]
    assert "twin" in found.path[0]


@pytest.mark.parametrize("size", [2.0, 0.5])
def test_effects_that_hide_each_other_are_found_beside_a_clear_one(size):
    """Worth more or less than x2; sets with x2 need no fit, for it is found alone."""
    true = {"x1": 8.0, "twin": -8.0, "x2": size}
    data, fitted = drawn(0, {"twin": lambda x, e: x["x1"] + 0.1 * e}, true), []
    data.together = lambda state, group: fitted.append(group) or Linear.together(data, state, group)
    found = selected(data)
    assert keys(found) == {*true}
    assert ("x1" in found.path[0]) == (size < 0.8)
    assert not any("x2" in c.keys for group in fitted for c in group)


@pytest.mark.parametrize("seed", range(5))
def test_what_later_effects_make_superfluous_is_deleted(seed):
    """A mixture of both true ones explains most alone, and nothing beside them."""
    mixture = {"both": lambda x, e: x["x1"] + x["x2"] + 0.7 * e}
    data = drawn(seed, mixture, {"x1": 2.0, "x2": 2.0})
    assert max(data.candidates(Model(data)), key=lambda c: c.evidence).keys == ("both",)
    steps = []
    assert pruned(data, Model(data, ("both", "x1", "x2")), steps.append).keys == ("x1", "x2")
    assert steps[0].startswith("- both")
    assert keys(selected(data)) == {"x1", "x2"}


@pytest.mark.parametrize("seed", range(5))
def test_a_rival_that_fits_better_takes_the_place(seed):
    data = drawn(seed, {"like": lambda x, e: x["x1"] + 0.3 * e}, {"x1": 1.0})
    base, begun = Model(data), Model(data, ("like",))
    before = Selection(base, base, known={c.keys: c for c in data.candidates(base)})
    steps = []
    found = compared(data, before, begun, steps.append)
    assert keys(found) == {"x1"}
    assert any("like → x1" in step for step in steps)
    (entry,) = found.entries
    assert entry.rivals[0].keys == ("like",)
    assert entry.evidence > entry.rivals[0].evidence


class Quarrel(Linear):
    """Each of two effects looks better than the other where the other stands."""

    def gains(self, smaller, larger):
        if {smaller.keys, larger.keys} == {("like",), ("x1",)}:
            return -60.0, -60.0
        return super().gains(smaller, larger)


def test_effects_that_replace_each_other_end():
    made = drawn(0, {"like": lambda x, e: x["x1"] + 0.3 * e}, {"x1": 1.0})
    data = Quarrel(made.x, made.y, made.held_x, made.held_y)
    base, steps = Model(data), []
    before = Selection(base, base, known={c.keys: c for c in data.candidates(base)})
    found = compared(data, before, Model(data, ("like",)), steps.append)
    assert len(steps) == 1
    assert [e.key for e in found.entries] == list(found.final.keys) == ["x1"]


class Late(Linear):
    """The value of an effect turns out to be impossible when its fit is settled."""

    def __init__(self, made, late):
        super().__init__(made.x, made.y, made.held_x, made.held_y)
        self.late = late

    def candidate(self, state, keys):
        return replace(super().candidate(state, keys), objection="")

    def objection(self, without, state, key):
        return "impossible" if key == self.late else ""


def test_a_rival_that_turns_out_to_be_impossible_takes_no_place():
    made = drawn(0, {"like": lambda x, e: x["x1"] + 0.3 * e}, {"x1": 1.0})
    for late, stays in (("x1", "like"), ("x7", "x1")):
        data = Late(made, late)
        base = Model(data)
        before = Selection(base, base, known={c.keys: c for c in data.candidates(base)})
        found = compared(data, before, Model(data, ("like",)), lambda _: None)
        assert found.final.keys == (stays,)


def test_what_held_out_logs_contradict_is_not_accepted():
    """As strong as can be on the fitted logs, of the other sign on the held-out ones."""
    data = drawn(1, {}, {"x3": 1.0}, flip=-0.5)
    (of_it,) = data.candidates(Model(data), ["x3"])
    assert of_it.gain > 4.0 * LEVEL
    assert of_it.held_gain < 0.0
    assert selected(data).entries == []


def test_what_is_impossible_is_not_accepted():
    data = drawn(1, {}, {"x3": 1.0}, objections={"x3": "it would lie beyond what is possible"})
    found = selected(data)
    assert found.entries == []
    assert found.rest[0].keys == ("x3",)
    assert found.rest[0].evidence > LEVEL


def test_an_effect_that_another_makes_impossible_gives_way_to_its_rival():
    data = drawn(2, {"x1": lambda x, noise: x["x0"] + 0.5 * noise}, {"x0": 1.0, "x3": 1.5})
    assert keys(selected(data)) == {"x0", "x3"}
    data.impossible = {"x0": "x3"}
    assert keys(selected(data)) == {"x1", "x3"}


def test_an_impossible_effect_without_a_rival_goes():
    data = drawn(3, {}, {"x0": 1.0, "x3": 1.5})
    data.impossible = {"x0": "x3"}
    assert keys(selected(data)) == {"x3"}


def entry(evidence, *rivals, objection=""):
    others = tuple(Candidate((f"r{i}",), r, 0.0, None, objection) for i, r in enumerate(rivals))
    return Entry("own", evidence, 0.0, others, None)


@pytest.mark.parametrize("evidence", [-1e9, 0.0, LEVEL, 1e3, 1e9])
@pytest.mark.parametrize("rival", [-1e9, 0.0, LEVEL, 1e3, 1e9])
def test_probability_is_between_none_and_one(evidence, rival):
    found = entry(evidence, rival).probability
    assert 0.0 <= found <= 1.0
    assert found >= entry(evidence - 1.0, rival).probability


def test_probability_against_its_closed_form():
    """Odds are exp of the difference over the temperature; against chance, and each rival."""
    odds = 3.0
    alone = LEVEL + TEMPERATURE * np.log(odds)
    assert entry(alone).probability == pytest.approx(odds / (1.0 + odds))
    assert entry(500.0, 500.0).probability == pytest.approx(0.5)
    assert entry(500.0, 500.0, 500.0).probability == pytest.approx(1.0 / 3.0)
    assert entry(500.0, 500.0, objection="impossible").probability == pytest.approx(1.0)


def test_confusable_are_those_that_come_near():
    near, far = 500.0 - 3.0 * TEMPERATURE, 500.0 - 5.0 * TEMPERATURE
    assert entry(500.0, near, far).confusable_with == ("r0",)


def test_explained_is_the_projection():
    rng = np.random.default_rng(4)
    columns, target = rng.standard_normal((50, 3)), rng.standard_normal(50)
    fitted = columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    assert explained(target, columns) == pytest.approx(float(fitted @ fitted))
    # what says the same twice, or nothing, explains no more
    again = np.column_stack([columns, columns[:, 0], np.zeros(50), columns @ [1.0, 2.0, 3.0]])
    assert explained(target, again) == pytest.approx(explained(target, columns), rel=1e-6)


def test_held_out_logs_object_by_more_than_the_evidence_scatters():
    """A spot that held-out logs do not pass: what the rest moves there is nothing beside it."""
    spot = Candidate(("a",), 20000.0, -20.0, None, error=700.0, held_error=10.0)
    assert spot.demanded
    assert not replace(spot, held_gain=-701.0).demanded
    assert not replace(spot, gain=300.0, error=12.0).demanded


def test_what_both_parts_of_the_logs_ask_for_enters_though_one_part_asks_for_more():
    """A limit that only fitted logs reach may stand for a set of effects, in fewer numbers."""
    drift = Candidate(("a",), 202.0, 283.0, None, numbers=2)
    limit = Candidate(("b",), 7127.0, 3.0, None, numbers=1)
    whole = Candidate(("a", "c"), 10040.0, 1882.0, None, numbers=4)
    plain = Candidate(("d",), 200.0, 280.0, None, numbers=1)
    assert best_of([limit, drift], 3.0) is drift
    assert best_of([limit, drift, whole], 3.0) is whole
    assert best_of([limit, drift, plain], 3.0) is plain  # as good as, and simpler


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("size", "kept"), [(1.0, True), (0.85, True), (0.3, False), (2.5, False)])
def test_held_out_logs_give_an_effect_its_size(seed, size, kept):
    """There it is `size` times as large: the squares fall by (2 size − 1) times its power."""
    data = drawn(seed, {}, {"x3": 2.0}, flip=size)
    state = Model(data, ("x3",))
    before, after = data.held_residuals(Model(data), state)
    found, error = held_size(before, after)
    # by regression on the held-out rows: slope, and its standard error
    x = state.values[1] * (data.held_x["x3"] - data.x["x3"].mean())
    (slope,), *_ = np.linalg.lstsq(x[:, None], before, rcond=None)
    assert found == pytest.approx(slope, rel=1e-9)
    assert error == pytest.approx(np.linalg.norm(x) ** -1, rel=1e-9)
    assert found == pytest.approx(size, abs=3.0 * error + 0.1)
    assert contradicted(before, after) is not kept
    entry = Entry("x3", *data.gains(Model(data), state), (), Model(data))
    left = confirmed(data, Selection(Model(data), state, [entry]))
    assert keys(left) == set(left.final.keys) == ({"x3"} if kept else set())
    assert bool(left.path) is not kept
    text = size_text(data, Model(data), state)
    assert text.startswith(f"on held-out logs the effect is {found:.2f} ± ")


def test_what_held_out_logs_hardly_excite_they_do_not_contradict():
    rng = np.random.default_rng(2)
    after = rng.standard_normal(500)
    after[:4] = 0.0
    moved = np.concatenate([np.full(4, 0.7), np.zeros(496)])
    assert not contradicted(after - moved, after)  # a power of 2 and a fall of 2, the wrong way
    assert contradicted(after - 20.0 * moved, after + 20.0 * moved)
    assert held_size(after, after) == (1.0, np.inf)
    assert not contradicted(after, after)


def test_of_two_that_are_contradicted_the_weaker_goes_and_both_are_looked_at_again():
    """x1 seems too large on held-out rows since its copy there is another one."""
    data = drawn(4, {"copy": lambda x, e: x["x1"] + 0.5 * e}, {"x1": 3.0})
    data.held_x["copy"] = data.held_x["x1"] * 4.0
    data.y = data.y + 1.2 * (data.x["copy"] - data.x["x1"])  # what happens to look like it
    state = Model(data, ("x1", "copy"))
    wrong = [contradicted(*data.held_residuals(data.without(state, k), state)) for k in state.keys]
    assert wrong == [True, True]
    entries = [
        Entry(k, *data.gains(data.without(state, k), state), (), data.without(state, k))
        for k in state.keys
    ]
    assert keys(confirmed(data, Selection(Model(data), state, entries))) == {"x1"}


def test_an_effect_is_looked_at_again_when_another_has_gone():
    class Told(Linear):
        def held_residuals(self, smaller, larger):
            wrong = {("x1", "x2", "x3"): "x2", ("x1", "x3"): "x1", ("x3",): ""}[larger.keys]
            (gone,) = {*larger.keys} - {*smaller.keys}
            return np.full(HELD, -1.0 if gone == wrong else 6.0), np.ones(HELD)

    made = drawn(1, {}, {"x1": 1.0, "x2": 2.0, "x3": 3.0})
    data = Told(made.x, made.y, made.held_x, made.held_y)
    state = Model(data, ("x1", "x2", "x3"))
    parts = [(k, data.without(state, k)) for k in state.keys]
    entries = [Entry(k, *data.gains(one, state), (), one) for k, one in parts]
    assert keys(confirmed(data, Selection(Model(data), state, entries))) == {"x3"}


def test_amplitudes_differ_from_zero_together():
    """The sum of two is identified, their difference is not: chi-squared by its closed form."""
    reported, vague = 1.0, 1e4
    turn = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    covariance = turn.T @ np.diag([reported**2, vague**2]) @ turn
    # of two degrees of freedom the tail beyond x is exp(-x / 2); 3 standard errors leave 0.0027
    least = np.sqrt(-2.0 * np.log(0.002699796))
    for size, there in ((1.001 * least, True), (0.999 * least, False)):
        amplitudes = turn.T @ np.array([size * reported, 0.0])
        assert differ(amplitudes, covariance) is there
        assert np.all(np.abs(amplitudes) < 0.01 * np.sqrt(np.diag(covariance)))
    assert differ(np.array([3.001]), np.array([[1.0]]))
    assert not differ(np.array([2.999]), np.array([[1.0]]))
