"""What printers of programs share: brackets by how operators bind, blocks by their depth."""

from collections.abc import Mapping
from typing import Any

from dmptm_ctrl.export.program import Assign, For, If, Item, Name, Op, Store, known

LEVEL = {
    "or": 1, "and": 2, "==": 3, "!=": 3, "<": 4, "<=": 4, ">": 4, ">=": 4,
    "+": 5, "-": 5, "*": 6, "/": 6,
}  # fmt: skip
UNARY, ATOM = 7, 9


class Printer:
    """Prints expressions and statements; a language says how it writes them."""

    signs: Mapping[str, str]  # of operators that are written otherwise
    set_to: str
    words: Mapping[str, str]  # around the blocks of branches and loops

    def number(self, value: float) -> str:
        """Text of a number that comes back to the last bit."""
        raise NotImplementedError

    def operation(self, op: str, args: tuple[Any, ...], kind: str) -> tuple[str, int]:
        """Text of an operation that is no sign between or before values, and how it binds."""
        raise NotImplementedError

    def assignment(self, item: Assign) -> list[str]:
        """Line that gives a name its value."""
        raise NotImplementedError

    def loop(self, item: For) -> str:
        """Line above the body of a loop."""
        raise NotImplementedError

    def name(self, name: str) -> str:
        """Return the name of a variable where it is read or set."""
        return name

    def text(self, value: Any, above: int = 0) -> str:
        """Text of an expression, in brackets where what is around it binds more."""
        text, level = self.parts(value)
        return f"({text})" if level < above else text

    def parts(self, value: Any) -> tuple[str, int]:
        """Text of an expression, and how strongly it binds."""
        if known(value):
            text = self.number(value)
            return text, UNARY if text.startswith("-") else ATOM
        if isinstance(value, Name):
            return self.name(value.id), ATOM
        if isinstance(value, Item):
            return f"{self.name(value.array.id)}[{self.text(value.index)}]", ATOM
        assert isinstance(value, Op)
        op, args = value.op, value.args
        sign = self.signs.get(op, op)
        if op in LEVEL:
            level = LEVEL[op]
            return f"{self.text(args[0], level)} {sign} {self.text(args[1], level + 1)}", level
        if op in ("neg", "not"):
            return f"{sign}{self.text(args[0], UNARY + 1)}", UNARY
        return self.operation(op, args, value.kind)

    def lines(self, block: list[Any], depth: int = 1) -> list[str]:
        """Lines of statements."""
        pad = "    " * depth
        found: list[str] = []
        for item in block:
            if isinstance(item, Assign):
                found += [pad + line for line in self.assignment(item)]
            elif isinstance(item, Store):
                place = self.text(Item(item.array, item.index))
                found.append(f"{pad}{place} {self.set_to} {self.text(item.value)};")
            elif isinstance(item, If):
                found.append(pad + self.words["if"].format(self.text(item.condition)))
                found += self.lines(item.body, depth + 1)
                if item.orelse:
                    found += [pad + self.words["else"], *self.lines(item.orelse, depth + 1)]
                found.append(pad + self.words["end if"])
            else:
                found += [pad + self.loop(item), *self.lines(item.body, depth + 1)]
                found.append(pad + self.words["end for"])
        return found
