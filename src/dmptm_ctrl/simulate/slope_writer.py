"""The writer of one function with slopes; see `slopes.py`."""

import ast
import inspect
import re
import textwrap
from collections.abc import Collection, Iterable
from typing import Any

from dmptm_ctrl.simulate.slope_text import (
    FUNCTIONS,
    KNOWN,
    OPERATORS,
    Dual,
    NoSlopes,
    Seed,
    Slopes,
    Tangents,
    as_float,
    far_apart,
    is_simple,
    looked_up_in,
    row_of,
    times,
)

MOST = 4  # things that must all be at rest to be asked for: with more it would cost too much
FEW = 3  # slopes that a value has before it goes on as something to depend on


class Writer:
    """Text of one function."""

    def __init__(self, library, function, motion, records, rests, still, chosen) -> None:
        self.library, self.function, self.rests = library, function, rests
        self.motion, self.records = tuple(motion), dict(records)
        self.still, self.chosen = still, chosen
        self.lines: list[Any] = []  # of text, or of what is returned
        self.depth, self.count = 1, 0
        self.sines: dict[str, tuple[str, str]] = {}
        self.seen: set[str] = set()
        self.deciding: set[tuple[str, int]] = set()
        self.looked_in: set[str] = set()  # records
        self.between: list[Tangents] = []  # slopes of values that others depend on
        try:
            source = textwrap.dedent(inspect.getsource(function))
            tree = ast.parse(source).body[0]
        except (OSError, TypeError, SyntaxError) as error:
            raise NoSlopes(f"source of {function!r} is not kept") from error
        if not isinstance(tree, ast.FunctionDef):
            raise NoSlopes(f"{function!r} is not a function with a name")
        self.tree = tree
        self.args = [a.arg for a in tree.args.args]
        self.env: dict[str, Dual] = {
            a: (a, {a: "1.0"} if a in self.motion else {}) for a in self.args
        }
        self.globals = dict(function.__globals__)
        cells = function.__closure__ or ()
        for name, cell in zip(function.__code__.co_freevars, cells, strict=True):
            self.globals[name] = cell.cell_contents

    def slopes(self, name: str) -> Slopes:
        """Write it."""
        if not self.block(self.tree.body):
            raise NoSlopes(f"{name} may end without a return")
        returned = [line for line in self.lines if not isinstance(line, str)]
        counts = {len(duals) for _, duals in returned}
        if len(counts) != 1:
            raise NoSlopes(f"{name} returns more or fewer values, as it goes")
        seeds = {s for _, duals in returned for _, slopes in duals for s in slopes}
        fields = tuple(sorted(s for s in seeds if isinstance(s, tuple) and isinstance(s[1], int)))
        found_in = {s[0] for s in seeds if isinstance(s, tuple) and isinstance(s[1], str)}
        if len(found_in) > 1:
            raise NoSlopes(f"{name} looks up in several records")
        found = max(len(self._found(duals)) for _, duals in returned)
        more = [x for x in self.rests.values() if is_simple(x)]
        looked_in = tuple(sorted(self.looked_in))
        for record in looked_in:
            more += looked_up_in(record)
        text = [f"@njit\ndef {name}({', '.join(self.args + more)}):", "    sure = True"]
        for line in self.lines:
            if isinstance(line, str):
                text.append(line)
                continue
            depth, duals = line
            here = self._found(duals)
            pad = found - len(here)
            motion = [slopes.get(m, "0.0") for _, slopes in duals for m in self.motion]
            own = [slopes.get(f, "0.0") for _, slopes in duals for f in fields]
            places = [str(s[1]) for s in here] + ["0"] * pad
            looked: list[str] = []
            for _, slopes in duals:
                looked += [slopes.get(s, "0.0") for s in here] + ["0.0"] * pad
            parts = [row_of(x) for x in ([v for v, _ in duals], motion, own, places, looked)]
            text.append("    " * depth + f"return {', '.join(parts)}, sure")
        return Slopes(
            *(name, "\n".join(text), counts.pop(), self.motion, fields, found),
            *(next(iter(found_in), ""), frozenset(self.deciding), looked_in),
        )

    def _found(self, duals: list[Dual]) -> list[Any]:
        """What of a record is found while it runs, that returned values depend on."""
        seeds = {s for _, slopes in duals for s in slopes if isinstance(s, tuple)}
        return sorted(s for s in seeds if isinstance(s[1], str))

    # Statements

    def emit(self, text: str) -> None:
        self.lines.append("    " * self.depth + text)

    def bind(self, text: str) -> str:
        """Name of a value."""
        if is_simple(text):
            return text
        self.count += 1
        self.emit(f"x_{self.count} = {text}")
        return f"x_{self.count}"

    def block(self, body: list[ast.stmt]) -> bool:
        """Write statements; whether they end in a return."""
        for statement in body:
            if isinstance(statement, ast.Return) and statement.value is not None:
                duals = self.several(statement.value)
                whole = [(as_float(v), self.put_in(slopes, 0)) for v, slopes in duals]
                self.lines.append((self.depth, whole))
                return True
            if isinstance(statement, ast.If):
                if self.branch(statement):
                    return True
            elif isinstance(statement, ast.Assign) and len(statement.targets) == 1:
                self.assign(statement.targets[0], self.several(statement.value))
            elif isinstance(statement, ast.AugAssign) and isinstance(statement.target, ast.Name):
                left = ast.Name(statement.target.id, ast.Load())
                value = self.value(ast.BinOp(left, statement.op, statement.value))
                self.assign(statement.target, [value])
            elif not (
                isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            ):
                raise NoSlopes(f"{ast.unparse(statement)!r} is not covered")
        return False

    def assign(self, target: ast.expr, duals: list[Dual]) -> None:
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        if len(names) != len(duals):
            raise NoSlopes(f"{ast.unparse(target)!r} does not match its values")
        for name, (value, slopes) in zip(names, duals, strict=True):
            if not isinstance(name, ast.Name):
                raise NoSlopes(f"{ast.unparse(target)!r} is not covered")
            self.env[name.id] = self.bind(value), slopes

    def branch(self, statement: ast.If) -> bool:
        """Write both ways, and let the names that they set go on with either's values."""
        test = self.bind(self.condition(statement.test))
        before, sines, seen = dict(self.env), self.sines, self.seen
        ways: list[tuple[bool, dict[str, Dual], list[Any]]] = []
        outer = self.lines
        for body in (statement.body, statement.orelse):
            self.env, self.sines, self.lines = dict(before), dict(sines), []
            self.seen = set(seen)
            self.depth += 1
            since = len(self.between)
            done = self.block(body)
            for name, (value, slopes) in self.env.items():
                if not done and before.get(name) != (value, slopes):
                    self.env[name] = value, self.put_in(slopes, since)
            ways.append((done, self.env, self.lines))
            self.depth -= 1
        self.lines, self.sines, self.seen = outer, sines, seen
        (done, yes, yes_lines), (other_done, no, no_lines) = ways
        self.env = dict(yes if other_done else no)
        if not (done or other_done):
            for name in sorted(yes.keys() & no.keys()):
                if yes[name] != no[name]:
                    self.env[name] = self._joined(name, yes[name], yes_lines, no[name], no_lines)
        self.emit(f"if {test}:")
        self.lines += yes_lines or ["    " * (self.depth + 1) + "pass"]
        if no_lines:
            self.emit("else:")
            self.lines += no_lines
        return done and other_done

    def _joined(self, name: str, yes: Dual, yes_lines: list, no: Dual, no_lines: list) -> Dual:
        """Value and slopes that either way has set."""
        self.count += 1
        joined: Tangents = {}
        pairs = [(f"{name}_{self.count}", yes[0], no[0])]
        for k, seed in enumerate(dict.fromkeys([*yes[1], *no[1]])):
            if isinstance(seed, tuple) and isinstance(seed[1], str):
                raise NoSlopes("a place found in one of two ways is not covered")
            joined[seed] = f"{name}_{self.count}_{k}"
            pairs.append((joined[seed], yes[1].get(seed, "0.0"), no[1].get(seed, "0.0")))
        for new, one, other in pairs:
            yes_lines.append("    " * (self.depth + 1) + f"{new} = {one}")
            no_lines.append("    " * (self.depth + 1) + f"{new} = {other}")
        return pairs[0][0], joined

    # Conditions

    def condition(self, node: ast.expr) -> str:
        """Text of a test, and before it whether a small change leaves it as it is."""
        if isinstance(node, ast.BoolOp):
            word = " and " if isinstance(node.op, ast.And) else " or "
            return "(" + word.join(self.condition(v) for v in node.values) + ")"
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return f"(not {self.condition(node.operand)})"
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            a, b = self.value(node.left), self.value(node.comparators[0])
            left, right = self.bind(a[0]), self.bind(b[0])
            self.guard([*a[1].items(), *b[1].items()], far_apart(left, right))
            compared = ast.Compare(
                ast.Name(left, ast.Load()), node.ops, [ast.Name(right, ast.Load())]
            )
            return f"({ast.unparse(compared)})"
        raise NoSlopes(f"{ast.unparse(node)!r} is not covered")

    def guard(self, slopes: Collection[tuple[Seed, str]], far: str) -> None:
        """Say that the branch is not sure where what is not `far` may change.

        What was chosen changes for a run as a whole, and is said to decide.
        """
        self.deciding |= self.chosen_among(s for s, _ in slopes)
        rests = self.resting(slopes)
        if rests != "True":
            self.see(f"({far})" if rests == "False" else f"({far}) | ({rests})")

    def see(self, text: str) -> None:
        """Say that the branch is sure only with a condition, once."""
        line = f"sure = sure & ({text})"  # no branches: both sides cost nothing
        if line not in self.seen:
            self.seen.add(line)
            self.emit(line)

    def chosen_among(self, seeds: Iterable[Seed]) -> set[tuple[str, int]]:
        """What is chosen once for a run, of what something depends on."""
        found: set[Any] = set()
        for seed in seeds:
            if isinstance(seed, int):
                found |= self.chosen_among(self.between[seed])
            elif seed in self.chosen:
                found.add(seed)
        return found

    def resting(self, slopes: Iterable[tuple[Seed, str]]) -> str:
        """Text of whether nothing changes of a value with these slopes, by what is not chosen."""
        terms = []
        for seed, slope in slopes:
            if seed in self.chosen:
                continue
            terms.append("False")
            if isinstance(seed, str):
                terms[-1] = self.rests.get(seed, "False")
            elif isinstance(seed, int):
                terms[-1] = self.resting(self.between[seed].items())
            if terms[-1] == "True":
                terms.pop()
            elif not re.fullmatch(r"\(?-?1\.0\)?", slope):
                still = f"({slope} == 0.0)"
                terms[-1] = still if terms[-1] == "False" else f"({still} | {terms[-1]})"
        terms = list(dict.fromkeys(terms))
        if "False" in terms or len(terms) > MOST:
            return "False"
        return " & ".join(terms) or "True"

    # Values

    def several(self, node: ast.expr) -> list[Dual]:
        """Values of a tuple, of a call, or a single one."""
        if isinstance(node, ast.Tuple):
            return [self.value(part) for part in node.elts]
        if isinstance(node, ast.Call):
            function = self.function_of(node)
            if function not in FUNCTIONS:
                return self.called(function, node)
        if isinstance(node, ast.IfExp) and isinstance(node.body, ast.Tuple):
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        return [self.value(node)]

    def value(self, node: ast.expr) -> Dual:
        """Text of a value and of its slopes."""
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            return repr(node.value), {}
        if isinstance(node, ast.Name):
            if node.id in self.records:
                raise NoSlopes(f"{node.id!r} as a whole is not covered")
            return self.env[node.id] if node.id in self.env else (self.constant(node), {})
        if isinstance(node, ast.Attribute) and not self._is_record(node.value):
            return self.constant(node), {}
        if isinstance(node, ast.Attribute | ast.Subscript):
            return self.field(node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            x, slopes = self.value(node.operand)
            return f"(-{x})", {s: times("-1.0", d) for s, d in slopes.items()}
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            return self.operation(OPERATORS[type(node.op)], node)
        if isinstance(node, ast.IfExp):
            test = self.bind(self.condition(node.test))
            return self.either(test, self.value(node.body), self.value(node.orelse))
        if isinstance(node, ast.Call):
            function = self.function_of(node)
            if function in FUNCTIONS:
                return self.known(FUNCTIONS[function], [self.value(a) for a in node.args])
            found = self.called(function, node)
            if len(found) == 1:
                return found[0]
        raise NoSlopes(f"{ast.unparse(node)!r} is not covered")

    def _is_record(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name) and node.id in self.records

    def constant(self, node: ast.expr) -> str:
        """Number that a name outside of the function stands for."""
        found = self.outside(node)
        if isinstance(found, bool | int | float):
            return repr(found)
        raise NoSlopes(f"{ast.unparse(node)!r} is not a number")

    def outside(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Name):
            builtin = {"abs": abs, "min": min, "max": max, "int": int}
            return self.globals.get(node.id, builtin.get(node.id))
        if isinstance(node, ast.Attribute):
            return getattr(self.outside(node.value), node.attr, None)
        return None

    def field(self, node: ast.Attribute | ast.Subscript) -> Dual:
        """Part of a record, by name or by place."""
        if not self._is_record(node.value):
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        record = node.value.id  # type: ignore[attr-defined]
        names = self.records[record]
        if isinstance(node, ast.Attribute):
            moves = (record, node.attr) not in self.still
            text = f"{record}.{node.attr}"
            return text, {(record, list(names).index(node.attr)): "1.0"} if moves else {}
        place, slopes = self.value(node.slice)
        if slopes:
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        try:
            index: int | str = int(ast.literal_eval(place))
        except ValueError:
            index = place = self.bind(place)
            self.looked_in.add(record)
            array, first = looked_up_in(record)
            text = f"{array}[{first} + {place}]"
        else:
            text = f"{record}[{place}]"
        moves = (record, index) not in self.still
        return text, {(record, index): "1.0"} if moves else {}

    def either(self, test: str, a: Dual, b: Dual) -> Dual:
        slopes = {
            s: self.bind(f"{a[1].get(s, '0.0')} if {test} else {b[1].get(s, '0.0')}")
            for s in dict.fromkeys([*a[1], *b[1]])
        }
        return self.bind(f"{a[0]} if {test} else {b[0]}"), self.few(slopes)

    def operation(self, sign: str, node: ast.BinOp) -> Dual:
        (a, da), (b, db) = self.value(node.left), self.value(node.right)
        if not (da or db):
            return f"({a} {sign} {b})", {}
        a, b = self.bind(a), self.bind(b)
        if sign == "/":  # divided once: the quotient may differ in its last digit
            part = self.bind(f"1.0 / {b}")
            value = self.bind(f"{a} * {part}")
            by = self.bind(f"-{value} * {part}") if db else ""
            return value, self.total([(da, part), (db, by)])
        value = self.bind(f"{a} {sign} {b}")
        if sign in "+-":
            back = {s: d if sign == "+" else times("-1.0", d) for s, d in db.items()}
            return value, self.total([(da, "1.0"), (back, "1.0")])
        if sign == "*":
            return value, self.total([(da, b), (db, a)])
        if db:
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        if sign == "%":
            far = f"({far_apart(value, '0.0', b)}) & ({far_apart(value, b)})"
            if self.resting(da.items()) != "True":
                self.see(far)
            return value, da
        power = times(b, a if b == "2" else f"{a} ** ({b} - 1.0)")
        return value, self.total([(da, self.bind(power))])

    def total(self, parts: list[tuple[Tangents, str]]) -> Tangents:
        """Slopes of a sum of changes, each times a factor."""
        return self.few(self.summed(parts))

    def summed(self, parts: list[tuple[Tangents, str]]) -> Tangents:
        terms: dict[Seed, list[str]] = {}
        for slopes, factor in parts:
            for seed, slope in slopes.items():
                terms.setdefault(seed, []).append(times(slope, factor))
        return {seed: self.bind(" + ".join(found)) for seed, found in terms.items()}

    def few(self, slopes: Tangents) -> Tangents:
        """Slopes, or the value itself as what others depend on, where these are many."""
        if len(slopes) <= FEW:
            return slopes
        self.between.append(slopes)
        return {len(self.between) - 1: "1.0"}

    def put_in(self, slopes: Tangents, since: int) -> Tangents:
        """Slopes with those of the values since some in the place of these."""
        for seed in range(len(self.between) - 1, since - 1, -1):
            if seed in slopes:
                rest = {s: d for s, d in slopes.items() if s != seed}
                slopes = self.summed([(rest, "1.0"), (self.between[seed], slopes[seed])])
        return slopes

    def known(self, name: str, args: list[Dual]) -> Dual:
        """Value and slopes of a function known by name."""
        texts = ", ".join(x for x, _ in args)
        slopes = args[0][1]
        if name in ("min", "max") and len(args) == 2:
            if not (slopes or args[1][1]):
                return f"{name}({texts})", {}
            a, b = ((self.bind(x), d) for x, d in args)
            self.guard([*a[1].items(), *b[1].items()], far_apart(a[0], b[0]))
            return self.either(self.bind(f"{a[0]} {'<' if name == 'min' else '>'} {b[0]}"), a, b)
        if len(args) != 1:
            raise NoSlopes(f"{name}({texts}) is not covered")
        if not slopes:
            return f"{name}({texts})", {}
        x = self.bind(texts)
        if name in ("floor", "int"):
            self.guard(slopes.items(), far_apart(x, f"floor({x} + 0.5)"))
            return f"{name}({x})", {}
        if name == "abs":
            self.guard(slopes.items(), far_apart(x, "0.0"))
            sign = self.bind(f"1.0 if {x} > 0.0 else -1.0")
            return self.bind(f"abs({x})"), self.total([(slopes, sign)])
        if name in ("sin", "cos"):
            if x not in self.sines:
                self.sines[x] = self.bind(f"sin({x})"), self.bind(f"cos({x})")
            sine, cosine = self.sines[x]
            if name == "sin":
                return sine, self.total([(slopes, cosine)])
            return cosine, self.total([(slopes, self.bind(f"-{sine}"))])
        value = self.bind(f"{name}({x})")
        return value, self.total([(slopes, self.bind(KNOWN[name].format(v=value, x=x)))])

    def function_of(self, node: ast.Call) -> Any:
        found = self.outside(node.func)
        if found is None or node.keywords or not callable(found):
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        return found

    def called(self, function: Any, node: ast.Call) -> list[Dual]:
        """Values and slopes of another kernel that this one calls."""
        plain = getattr(function, "py_func", function)
        if not inspect.isfunction(plain) or any(isinstance(a, ast.Starred) for a in node.args):
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        names = list(inspect.signature(plain).parameters)
        if len(names) != len(node.args):
            raise NoSlopes(f"{ast.unparse(node)!r} is not covered")
        renamed = {
            arg.id: name
            for name, arg in zip(names, node.args, strict=True)
            if isinstance(arg, ast.Name) and arg.id in self.records
        }
        duals = {
            name: self.value(arg)
            for name, arg in zip(names, node.args, strict=True)
            if not self._is_record(arg)
        }
        inner = self.library.of(
            plain,
            [name for name, (_, slopes) in duals.items() if slopes],
            {inside: self.records[here] for here, inside in renamed.items()},
            speeds=None,
            still=sorted(((renamed[r], f) for r, f in self.still if r in renamed), key=str),
            chosen=sorted((renamed[r], k) for r, k in self.chosen if r in renamed),
        )
        back = {inside: here for here, inside in renamed.items()}
        self.deciding |= {(back[r], k) for r, k in inner.deciding}
        given = [duals[n][0] if n in duals else back[n] for n in names]
        given += [self.resting(duals[m][1].items()) for m in inner.motion]
        for record in inner.looked_in:
            given += looked_up_in(back[record])
            self.looked_in.add(back[record])
        result = self.bind(f"{inner.name}({', '.join(given)})")
        self.emit(f"sure = sure & {result}[5]")
        places = [self.bind(f"{result}[3][{k}]") for k in range(inner.found)]
        found: list[Dual] = []
        for o in range(inner.values):
            parts = [
                (duals[m][1], self.bind(f"{result}[1][{o * len(inner.motion) + k}]"))
                for k, m in enumerate(inner.motion)
            ]
            own: Tangents = {
                (back[r], at): self.bind(f"{result}[2][{o * len(inner.fields) + k}]")
                for k, (r, at) in enumerate(inner.fields)
            }
            for k, place in enumerate(places):
                own[back[inner.record], place] = self.bind(f"{result}[4][{o * inner.found + k}]")
            found.append((self.bind(f"{result}[0][{o}]"), self.total([*parts, (own, "1.0")])))
        return found
