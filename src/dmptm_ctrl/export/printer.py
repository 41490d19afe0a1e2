"""What printers of programs share: brackets by how operators bind, blocks by their depth."""

from collections.abc import Callable, Mapping
from math import copysign
from typing import Any

from dmptm_ctrl.export import program as ir

LEVEL = {
    "or": 1, "and": 2, "==": 3, "!=": 3, "<": 4, "<=": 4, ">": 4, ">=": 4,
    "+": 5, "-": 5, "*": 6, "/": 6,
}  # fmt: skip
UNARY, ATOM = 7, 9
REALS = ("double", "float")
LEAST, MOST = 1.1754944e-38, 3.4028234e38  # magnitudes of a float


def in_float(value: float) -> float:
    """Return a number as a float can have it: not 0 where it is small, nor endless."""
    size = min(max(abs(value), LEAST), MOST)
    return copysign(size, value) if value else 0.0


class Printer:
    """Prints expressions and statements; a language says how it writes them."""

    types: Mapping[str, str]  # of double and float, of whole numbers and truth values
    signs: Mapping[str, str]  # of operators that are written otherwise
    set_to: str
    output: str  # before the name of an output that is set
    words: Mapping[str, str]  # around the blocks of branches and loops

    truth: tuple[str, str]  # false and true
    # text of a real number that comes back to the last bit, as a float has it if that is short
    literal: Callable[[float, bool], str]
    # text of a real or wide value as the other of them, and how it binds
    cast: Callable[[Any, str], tuple[str, int]]
    # text of an operation that is no sign between or before values, and how it binds
    operation: Callable[[str, tuple[Any, ...], str], tuple[str, int]]
    assignment: Callable[[ir.Assign], list[str]]  # lines that give a name its value
    loop: Callable[[ir.For], str]  # line above the body of a loop

    def __init__(self, real: str) -> None:
        if real not in REALS:
            raise ValueError(f"real is {real!r}; it must be one of {', '.join(REALS)}")
        self.real = real
        self.narrow = real == "float"  # a real number is narrower than a wide one

    def kind(self, kind: str) -> str:
        """Return the language's type of a kind."""
        return self.types[{ir.REAL: self.real, ir.WIDE: "double"}.get(kind, kind)]

    def number(self, value: float, kind: str | None = None) -> str:
        """Text of a number, of a kind if one is given."""
        if isinstance(value, bool):
            return self.truth[value]
        if isinstance(value, int):
            return str(value)
        return self.literal(float(value), self.narrow and kind != ir.WIDE)

    def name(self, name: str) -> str:
        """Return the name of a variable where it is read or set."""
        return name

    def text(self, value: Any, above: int = 0, kind: str | None = None) -> str:
        """Text of an expression, of a kind, in brackets where what is around it binds more."""
        text, level = self.parts(value, kind)
        return f"({text})" if level < above else text

    def parts(self, value: Any, kind: str | None = None) -> tuple[str, int]:
        """Text of an expression, and how strongly it binds."""
        if ir.known(value):
            text = self.number(value, kind)
            return text, UNARY if text.startswith("-") else ATOM
        if self.narrow and {kind, ir.kind_of(value)} == {ir.REAL, ir.WIDE}:
            return self.cast(value, kind or ir.REAL)
        if isinstance(value, ir.Name):
            return self.name(value.id), ATOM
        if isinstance(value, ir.Item):
            return f"{self.name(value.array.id)}[{self.text(value.index)}]", ATOM
        assert isinstance(value, ir.Op)
        op, args = value.op, value.args
        sign = self.signs.get(op, op)
        if op in LEVEL:
            level, both = LEVEL[op], ir.widest(args)
            a, b = (self.text(x, level + k, both) for k, x in enumerate(args))
            return f"{a} {sign} {b}", level
        if op in ("neg", "not"):
            return f"{sign}{self.text(args[0], UNARY + 1)}", UNARY
        return self.operation(op, args, value.kind)

    def step(self, program: ir.Program) -> list[str]:
        """Lines of a whole step: its statements, then the new outputs and state."""
        found = self.lines(program.body)
        ends = zip(program.outputs, program.results, strict=True)
        new = [(f"{self.output}{p.name}", value, p.kind) for p, value in ends]
        new += [(self.name(n.id), value, n.kind) for n, value in program.after]
        return found + [f"    {to} {self.set_to} {self.text(x, 0, kind)};" for to, x, kind in new]

    def lines(self, block: list[Any], depth: int = 1) -> list[str]:
        """Lines of statements."""
        pad = "    " * depth
        found: list[str] = []
        for item in block:
            if isinstance(item, ir.Assign):
                found += [pad + line for line in self.assignment(item)]
            elif isinstance(item, ir.Store):
                place = self.text(ir.Item(item.array, item.index))
                found.append(f"{pad}{place} {self.set_to} {self.text(item.value, 0, ir.REAL)};")
            elif isinstance(item, ir.If):
                found.append(pad + self.words["if"].format(self.text(item.condition)))
                found += self.lines(item.body, depth + 1)
                if item.orelse:
                    found += [pad + self.words["else"], *self.lines(item.orelse, depth + 1)]
                found.append(pad + self.words["end if"])
            else:
                found += [pad + self.loop(item), *self.lines(item.body, depth + 1)]
                found.append(pad + self.words["end for"])
        return found
