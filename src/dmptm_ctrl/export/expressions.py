"""Values of expressions, in which some parts are numbers and others are names."""

import ast
from collections.abc import Callable, Mapping
from math import isclose
from typing import Any

import numpy as np

from dmptm_ctrl.export import program as ir
from dmptm_ctrl.export.tracer import Cells, Latest, NotScalar, Range, Ring, Signals, Tracer
from dmptm_ctrl.simulate.elementary import arrays_at, borrowed, called_at, gather, spread

_SIGNS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=",
    ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.Mod: "mod",
}  # fmt: skip


class Expressions:
    """Values of expressions among the variables of one function; its statements are elsewhere."""

    # follow two ways, of which only the running program knows which is taken
    split: Callable[[Any, list[Callable[[], Any]], str], Any]
    follow: Callable[[Any, list[Any]], Any]  # a call
    put: Callable[[Any, Any, Any], None]  # write an element of a container at an index

    def __init__(
        self, tracer: Tracer, env: dict[str, Any], names: Mapping[str, Any], title: str = "result"
    ) -> None:
        self.tracer, self.env, self.names, self.title = tracer, env, names, title

    def value(self, node: ast.expr) -> Any:
        """Value of an expression."""
        kind = type(node).__name__
        method = getattr(self, f"_{kind.lower()}_value", None)
        if method is None:
            raise NotScalar(f"cannot follow a {kind} in line {node.lineno}")
        return method(node)

    def _constant_value(self, node: ast.Constant) -> Any:
        return node.value

    def _name_value(self, node: ast.Name) -> Any:
        if node.id in self.env:
            return self.env[node.id]
        if node.id in self.names:
            return plain(self.names[node.id])
        builtins = self.names.get("__builtins__")
        table = builtins if isinstance(builtins, dict) else vars(builtins)
        if node.id in table:
            return table[node.id]
        raise NotScalar(f"{node.id} has no value on every way to line {node.lineno}")

    def _tuple_value(self, node: ast.Tuple) -> Any:
        return tuple(map(self.value, node.elts))

    _list_value = _tuple_value

    def _attribute_value(self, node: ast.Attribute) -> Any:
        owner = self.value(node.value)
        if isinstance(owner, ir.Array) and node.attr in owner.fields:
            return ir.Item(owner, owner.fields.index(node.attr))
        return plain(getattr(owner, node.attr))

    def _unaryop_value(self, node: ast.UnaryOp) -> Any:
        value = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            return ir.make("not", value)
        return value if isinstance(node.op, ast.UAdd) else ir.make("neg", value)

    def _binop_value(self, node: ast.BinOp) -> Any:
        return self._binary(node.op, self.value(node.left), self.value(node.right))

    def _binary(self, op: ast.operator, a: Any, b: Any) -> Any:
        if isinstance(op, ast.Pow):
            return self._power(a, b)
        if type(op) not in _SIGNS:
            raise NotScalar(f"no operation {type(op).__name__}")
        kind = ir.widest((a, b))
        if isinstance(op, ast.Mod) and kind in (ir.REAL, ir.WIDE):
            a, b = self.tracer.kept("dividend", a), self.tracer.kept("divisor", b)
            turns = ir.make(kind, ir.make("floor", ir.make("/", a, b)))
            return ir.make("-", a, ir.make("*", b, turns))
        return ir.make(_SIGNS[type(op)], a, b)

    def _power(self, base: Any, exponent: Any) -> Any:
        if ir.known(exponent) and not ir.known(base):
            if exponent == 2:
                base = self.tracer.kept("base", base)
                return ir.make("*", base, base)
            if exponent == 1:
                return base
            if isclose(exponent, 0.5, rel_tol=0.0):
                return ir.make("sqrt", base)
        return ir.make("pow", ir.make("real", base), ir.make("real", exponent))

    def _compare_value(self, node: ast.Compare) -> Any:
        left, result = self.value(node.left), True
        for op, right_node in zip(node.ops, node.comparators, strict=True):
            right = self.value(right_node)
            result = ir.make("and", result, ir.make(_SIGNS[type(op)], left, right))
            left = right
        return result

    def _boolop_value(self, node: ast.BoolOp) -> Any:
        is_and = isinstance(node.op, ast.And)
        value = self.value(node.values[0])
        for other in node.values[1:]:
            if ir.known(value):
                if bool(value) is not is_and:
                    return value
                value = self.value(other)
                continue
            value = self._logic(is_and, value, other)
        return value

    def _logic(self, is_and: bool, value: Any, other: ast.expr) -> Any:
        """And, or; the second is looked at only where the first leaves it open."""
        block: list[Any] = []
        with self.tracer.collected(block):
            right = self.value(other)
        if not block:
            return ir.make("and" if is_and else "or", value, right)
        stop = not is_and

        def more() -> Any:
            self.tracer.block += block
            return right

        ways: list[Callable[[], Any]] = [more, lambda: stop]
        return self.split(value, ways if is_and else ways[::-1], "holds")

    def _ifexp_value(self, node: ast.IfExp) -> Any:
        test = self.value(node.test)
        if ir.known(test):
            return self.value(node.body if test else node.orelse)
        ways = [lambda: self.value(node.body), lambda: self.value(node.orelse)]
        return self.split(test, ways, "choice")

    def _subscript_value(self, node: ast.Subscript) -> Any:
        return self.item(self.value(node.value), self.value(node.slice))

    def item(self, owner: Any, index: Any) -> Any:
        """Element of an array, a tuple or cells."""
        if isinstance(owner, Cells) and ir.known(index):
            return self.tracer.heap[id(owner), int(index) % owner.size]
        if isinstance(owner, Signals):
            return self.item(owner.rings[index[0]], index[1])
        if isinstance(owner, Latest):
            return owner.value
        if isinstance(owner, Ring):
            return ir.Item(owner.array, ir.make("mod", index, owner.array.size))
        if isinstance(owner, ir.Array):
            return ir.Item(owner, index)
        if isinstance(owner, tuple | np.ndarray):
            parts = index if isinstance(index, tuple) else (index,)
            if any(isinstance(p, ir.Name | ir.Op | ir.Item) for p in parts):
                return self._looked_up(tuple(plain(v) for v in owner), index)
            return plain(owner[index])
        raise NotScalar(f"cannot read a {type(owner).__name__} at {index!r}")

    def _looked_up(self, values: tuple[Any, ...], index: Any) -> Any:
        if not all(ir.known(v) for v in values):
            raise NotScalar("a table of numbers that are not known")
        first = 0
        if isinstance(index, ir.Op) and index.op == "+":
            a, b = index.args
            first, index = (a, b) if ir.known(a) else (b, a) if ir.known(b) else (0, index)
        if isinstance(index, ir.Op) and index.op == "+" and ir.known(index.args[0]):
            first, index = first + index.args[0], index.args[1]
        table = self.tracer.table(tuple(float(v) for v in values))
        return ir.Item(table, ir.make("+", index, first))

    def _call_value(self, node: ast.Call) -> Any:
        function, args = self.value(node.func), [self.value(arg) for arg in node.args]
        name = getattr(function, "__name__", "")
        module = getattr(function, "__module__", "") or ""
        if function is range:
            return Range(*(args if len(args) == 2 else (0, *args)))
        if function in (float, int, bool, abs, min, max, len):
            return _builtin(function, args)
        elementary = module == "math" or module.endswith("elementary")
        if elementary and name in ("pow", "power"):
            return self._power(*args)
        if elementary and name in ir.FUNCTIONS:
            return ir.make(name, ir.make("real", args[0]))
        if function is borrowed or function is arrays_at:
            return args[0]
        if function is spread:
            return tuple(self.item(args[0], ir.make("+", args[2], i)) for i in range(args[1]))
        if function is gather:
            for i, item in enumerate(args[1]):
                self.put(args[0], ir.make("+", args[2], i), item)
            return None
        if function is called_at:
            return self.follow(args[0], list(args[1]))
        if isinstance(function, type) and hasattr(function, "_fields"):
            return function(*args)
        if callable(function):
            return self.follow(function, args)
        raise NotScalar(f"cannot call {function!r}")


def _builtin(function: Any, args: list[Any]) -> Any:
    if function is len:
        return len(args[0])
    if function is abs:
        return ir.make("abs", args[0])
    if function in (min, max):
        value = args[0]
        for other in args[1:]:
            value = ir.make(function.__name__, value, other)
        return value
    if ir.known(args[0]):
        return function(args[0])
    if function is float:
        return ir.make("real", args[0])
    if function is int:
        return args[0] if ir.kind_of(args[0]) == ir.INT else ir.make("trunc", args[0])
    return args[0] if ir.kind_of(args[0]) == ir.BOOL else ir.make("!=", args[0], 0)


def plain(value: Any) -> Any:
    """Python's number in place of numpy's."""
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    return float(value) if isinstance(value, np.floating) else value
