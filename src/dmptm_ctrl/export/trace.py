"""Read scalar Python as numba takes it, put in what is known, and write down what is left.

Calls are followed into their functions. What depends on known numbers alone is computed; a
branch whose condition is known is taken; loops over few turns are written out. So the program
of a plant or a controller has only what that plant or controller needs.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable
from functools import cache
from typing import Any

from dmptm_ctrl.export import program as ir
from dmptm_ctrl.export.expressions import Expressions
from dmptm_ctrl.export.tracer import (
    Cells,
    Merge,
    NotScalar,
    Range,
    Returned,
    Row,
    Signals,
    Tracer,
    same,
)

UNROLLED = 4  # turns of a loop that are written out one by one
MOST_ROUNDS = 50  # until a loop's variables are known
_NOTHING = object()


def follow(tracer: Tracer, function: Any, args: list[Any]) -> Any:
    """Follow a function on these arguments; return what it returns, or raise `NotScalar`."""
    function = getattr(function, "py_func", function)
    tree = function_tree(function)
    env: dict[str, Any] = {}
    for parameter, value in zip(tree.args.args, args, strict=True):
        env[parameter.arg] = tracer.kept(parameter.arg, value)
    scope = Scope(tracer, env, function.__globals__, function.__name__.strip("_"))
    result = scope.run(tree.body)
    return result.value if isinstance(result, Returned) else None


@cache
def function_tree(function: Callable[..., Any]) -> ast.FunctionDef:
    """Parsed source of a function."""
    try:
        text = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        raise NotScalar(f"{function!r} has no source") from None
    tree = ast.parse(text).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise NotScalar(f"{function!r} is no plain function")
    return tree


class _Continue(Exception):
    pass


class Scope(Expressions):
    """Variables of one function while it is followed."""

    def run(self, body: list[ast.stmt]) -> Returned | None:
        """Follow statements."""
        for k, node in enumerate(body):
            if isinstance(node, ast.Return):
                return Returned(None if node.value is None else self.value(node.value))
            if isinstance(node, ast.If):
                done = self._branch(node, body[k + 1 :])
                if done is not _NOTHING:
                    return done
            else:
                self._statement(node)
        return None

    def _statement(self, node: ast.stmt) -> None:
        if isinstance(node, ast.Assign):
            value = self.value(node.value)
            for target in node.targets:
                self.assign(target, value)
        elif isinstance(node, ast.AugAssign):
            old, other = self.value(node.target), self.value(node.value)
            self.assign(node.target, self._binary(node.op, old, other))
        elif isinstance(node, ast.For):
            self._loop(node)
        elif isinstance(node, ast.Expr):
            if not isinstance(node.value, ast.Constant):
                self.value(node.value)
        elif isinstance(node, ast.Continue):
            raise _Continue
        elif not isinstance(node, ast.Pass):
            raise NotScalar(f"cannot follow a {type(node).__name__} in line {node.lineno}")

    def assign(self, target: ast.expr, value: Any) -> None:
        """Bind a target to a value."""
        if isinstance(target, ast.Name):
            self.env[target.id] = self.tracer.kept(target.id, value)
        elif isinstance(target, ast.Tuple):
            # all values before any name gets one, as in a, b = b, a
            parts = [
                self.tracer.kept(t.id, v) if isinstance(t, ast.Name) else v
                for t, v in zip(target.elts, value, strict=True)
            ]
            for part, given in zip(target.elts, parts, strict=True):
                self.assign(part, given)
        elif isinstance(target, ast.Subscript):
            self.put(self.value(target.value), self.value(target.slice), value)
        else:
            raise NotScalar(f"cannot assign to a {type(target).__name__}")

    def put(self, container: Any, index: Any, value: Any) -> None:
        """Write an element of cells or of an array."""
        if isinstance(container, Row):
            container, index = container.cells, index[1]
        if isinstance(container, Signals):
            container, index = container.rings[index[0]], index[1]
        if isinstance(container, Cells) and ir.known(index):
            place = id(container), int(index) % container.size
            self.tracer.heap[place] = self.tracer.kept(self.tracer.title(place), value)
        elif isinstance(container, ir.Array) and container.values is None:
            self.tracer.block.append(ir.Store(container, index, value))
        else:
            raise NotScalar(f"cannot write into a {type(container).__name__}")

    # branches

    def _branch(self, node: ast.If, rest: list[ast.stmt]) -> Any:
        """Follow an if; the function's result if it, or what comes behind it, ends there."""
        test = self.value(node.test)
        if ir.known(test):
            done = self.run(node.body if test else node.orelse)
            return _NOTHING if done is None else done
        ends = any(isinstance(part, ast.Return) for part in ast.walk(node))
        tail = rest if ends else []
        both = [lambda: self.run([*node.body, *tail]), lambda: self.run([*node.orelse, *tail])]
        result = self.split(test, both, self.title)
        if not ends:
            return _NOTHING
        return result if result is None else Returned(result[0])

    def split(self, test: Any, both: list[Callable[[], Any]], title: str) -> Any:
        """Follow two ways; where they leave variables different, merge them under one name."""
        before, heap = dict(self.env), dict(self.tracer.heap)
        ways = []
        for way in both:
            block: list[Any] = []
            self.env, self.tracer.heap = dict(before), dict(heap)
            try:
                with self.tracer.collected(block):
                    result = way()
            except _Continue:
                raise NotScalar("cannot follow a continue on a condition not known") from None
            ways.append((block, self.env, self.tracer.heap, result))
        (body, env_1, heap_1, result_1), (orelse, env_2, heap_2, result_2) = ways
        merge = Merge(self.tracer, body, orelse)
        self.env = {k: merge.of(k, env_1[k], env_2[k]) for k in env_1 if k in env_2}
        self.tracer.heap = {
            k: merge.of(self.tracer.title(k), heap_1[k], heap_2[k]) for k in heap_1 if k in heap_2
        }
        result = merge.of(title, result_1, result_2)
        self.tracer.block += merge.declared
        if body or orelse:
            self.tracer.block.append(ir.If(test, body, orelse))
        return result

    # loops

    def _loop(self, node: ast.For) -> None:
        turns = self.value(node.iter)
        if not isinstance(turns, Range):
            raise NotScalar("a loop must be over a range")
        if ir.known(turns.start) and ir.known(turns.stop) and (
            turns.stop - turns.start <= UNROLLED or _needs_place(node)
        ):  # fmt: skip
            for k in range(turns.start, turns.stop):
                self.assign(node.target, k)
                try:
                    done = self.run(node.body)
                except _Continue:
                    continue
                if done is not None:
                    raise NotScalar("cannot follow a return inside a loop")
            return
        counter = self.tracer.fresh("k", ir.INT)
        block: list[Any] = []

        def body() -> None:
            self.assign(node.target, ir.make("+", counter, turns.start))
            if self.run(node.body) is not None:
                raise NotScalar("cannot follow a return inside a loop")

        entry, moved = self.turning(block, body, keep=False)
        for name, start, _ in entry:
            self.tracer.block.append(ir.Assign(name, start))
        block += moved
        count = ir.make("-", turns.stop, turns.start)
        self.tracer.block.append(ir.For(counter, count, block))

    def turning(
        self, block: list[Any], body: Callable[[], None], *, keep: bool
    ) -> tuple[list[tuple[ir.Name, Any, Any]], list[Any]]:
        """Follow a body that repeats, until it is known which variables it carries.

        `block` gets the statements of one turn. With `keep` the carried variables stand in a state,
        else in plain names. Returns (name, value before, value behind one turn) of each, and the
        statements that give plain names their new values.
        """
        tracer = self.tracer
        env, heap = dict(self.env), dict(tracer.heap)
        taken, tables = dict(tracer.taken), dict(tracer.tables)
        carried: dict[Any, str] = {}
        for _ in range(MOST_ROUNDS):
            self.env, tracer.heap = dict(env), dict(heap)
            tracer.taken, tracer.tables = dict(taken), dict(tables)
            del block[:]
            names: dict[Any, ir.Name] = {}
            for place, kind in carried.items():
                names[place] = tracer.fresh(self._base(place), kind)
                self._set(place, names[place])
            inside, inner = dict(self.env), dict(tracer.heap)
            with tracer.collected(block):
                body()
            changed = dict(carried)
            for place, old, new in _leaves(inside, inner, self.env, tracer.heap):
                if same(old, new):
                    continue
                if not ir.known(new) and not isinstance(new, ir.Name | ir.Op | ir.Item):
                    raise NotScalar(f"{self._base(place)} changes what it is within a loop")
                kinds = {ir.kind_of(old), ir.kind_of(new), carried.get(place, ir.BOOL)}
                kinds |= {ir.WIDE} if place[1] in tracer.wide else set()
                changed[place] = next(k for k in (ir.WIDE, ir.REAL, ir.INT, ir.BOOL) if k in kinds)
            if changed == carried:
                break
            carried = changed
        else:
            raise NotScalar("a loop whose variables never settle")
        found = []
        before_env, before_heap = dict(self.env), dict(tracer.heap)
        for place, name in names.items():
            new = _get(place, before_env, before_heap)
            old = _get(place, env, heap)
            if name.kind in (ir.REAL, ir.WIDE):
                old, new = ir.make(name.kind, old), ir.make(name.kind, new)
            found.append((name, old, new))
            if not keep:
                self._set(place, name)
        moves: list[Any] = []
        if not keep:
            busy = {name.id for name in names.values()}
            for k, (name, old, new) in enumerate(found):
                if isinstance(new, ir.Name) and new.id in busy and new != name:
                    spare = tracer.fresh(name.id, name.kind)
                    moves.append(ir.Assign(spare, new))
                    found[k] = name, old, spare
            moves += [ir.Assign(n, new, declare=False) for n, _, new in found if new != n]
        return found, moves

    def _base(self, place: Any) -> str:
        kind, key, _ = place
        return key if kind == "env" else self.tracer.title(key)

    def _set(self, place: Any, value: Any) -> None:
        kind, key, path = place
        store: dict[Any, Any] = self.env if kind == "env" else self.tracer.heap
        store[key] = _replaced(store[key], path, value)

    def follow(self, function: Any, args: list[Any]) -> Any:
        """Follow a call."""
        return follow(self.tracer, function, args)


def _needs_place(node: ast.For) -> bool:
    """Whether the loop's counter says which cell is meant."""
    return any(
        isinstance(part, ast.Subscript)
        and any(isinstance(n, ast.Name) and n.id == getattr(node.target, "id", "") for n in
                ast.walk(part.slice))
        for part in ast.walk(node)
    )  # fmt: skip


def _leaves(env_1: Any, heap_1: Any, env_2: Any, heap_2: Any) -> list[tuple[Any, Any, Any]]:
    found: list[tuple[Any, Any, Any]] = []

    def look(kind: str, key: Any, path: tuple[int, ...], a: Any, b: Any) -> None:
        if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
            for k, (x, y) in enumerate(zip(a, b, strict=True)):
                look(kind, key, (*path, k), x, y)
        else:
            found.append(((kind, key, path), a, b))

    for kind, first, second in (("env", env_1, env_2), ("heap", heap_1, heap_2)):
        for key in first:
            if key in second:
                look(kind, key, (), first[key], second[key])
    return found


def _get(place: Any, env: Any, heap: Any) -> Any:
    kind, key, path = place
    value = (env if kind == "env" else heap)[key]
    for k in path:
        value = value[k]
    return value


def _replaced(value: Any, path: tuple[int, ...], new: Any) -> Any:
    if not path:
        return new
    parts = list(value)
    parts[path[0]] = _replaced(parts[path[0]], path[1:], new)
    return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
