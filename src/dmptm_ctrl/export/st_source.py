"""A program as a function block in Structured Text, IEC 61131-3."""

from typing import Any

from dmptm_ctrl.export.program import (
    BOOL,
    INT,
    REAL,
    Assign,
    For,
    If,
    Item,
    Name,
    Op,
    Program,
    Store,
    ascii_text,
    known,
)

REALS = {"double": "LREAL", "float": "REAL"}
_LEVEL = {
    "or": 1, "and": 2, "==": 3, "!=": 3, "<": 4, "<=": 4, ">": 4, ">=": 4,
    "+": 5, "-": 5, "*": 6, "/": 6,
}  # fmt: skip
_SIGN = {"or": "OR", "and": "AND", "==": "=", "!=": "<>"}
_UNARY, _ATOM = 7, 9
_CALLS = {"log": "LN"}


class StPrinter:
    """Prints expressions and statements; collects the variables that they set."""

    def __init__(self, real: str) -> None:
        if real not in REALS:
            raise ValueError(f"real is {real!r}; it must be one of {', '.join(REALS)}")
        self.real = REALS[real]
        self.variables: dict[str, str] = {}

    def kind(self, kind: str) -> str:
        """Type of a kind."""
        return {REAL: self.real, INT: "DINT", BOOL: "BOOL"}[kind]

    def number(self, value: float) -> str:
        """Text of a number that comes back to the last bit."""
        if isinstance(value, bool):
            return "TRUE" if value else "FALSE"
        if isinstance(value, int):
            return str(value)
        if value != value or abs(value) == float("inf"):
            raise ValueError(f"Structured Text has no literal for {value}")
        mantissa, sign, exponent = repr(float(value)).partition("e")
        if "." not in mantissa:
            mantissa += ".0"
        return mantissa + (f"E{exponent}" if sign else "")

    def text(self, value: Any, above: int = 0) -> str:
        """Text of an expression, in brackets where what is around it binds more."""
        text, level = self._parts(value)
        return f"({text})" if level < above else text

    def _parts(self, value: Any) -> tuple[str, int]:
        if known(value):
            text = self.number(value)
            return text, _UNARY if text.startswith("-") else _ATOM
        if isinstance(value, Name):
            return value.id, _ATOM
        if isinstance(value, Item):
            return f"{value.array.id}[{self.text(value.index)}]", _ATOM
        return self._operation(value)

    def _operation(self, value: Op) -> tuple[str, int]:
        op, args = value.op, value.args
        if op in _LEVEL:
            level = _LEVEL[op]
            sign = _SIGN.get(op, op)
            return f"{self.text(args[0], level)} {sign} {self.text(args[1], level + 1)}", level
        if op == "neg":
            return f"-{self.text(args[0], _UNARY + 1)}", _UNARY
        if op == "not":
            return f"NOT {self.text(args[0], _UNARY + 1)}", _UNARY
        if op == "mod":
            a, n = self.text(args[0], _LEVEL["*"]), self.text(args[1], _UNARY)
            return f"(({a} MOD {n}) + {n}) MOD {n}", _LEVEL["*"]
        if op == "pow":
            return f"EXPT({self.text(args[0])}, {self.text(args[1])})", _ATOM
        if op == "real":
            return f"DINT_TO_{self.real}({self.text(args[0])})", _ATOM
        if op == "trunc":
            return f"TRUNC({self.text(args[0])})", _ATOM
        if op == "floor":  # the standard rounds towards zero only
            x = self.text(args[0])
            down = f"DINT_TO_{self.real}(TRUNC({x})) > {self.text(args[0], _LEVEL['+'])}"
            return f"TRUNC({x}) - BOOL_TO_DINT({down})", _LEVEL["-"]
        if op == "tanh":  # the standard has none
            return f"1.0 - 2.0 / (EXP(2.0 * {self.text(args[0], _UNARY)}) + 1.0)", _LEVEL["-"]
        name = _CALLS.get(op, op.upper())
        return f"{name}({', '.join(self.text(a) for a in args)})", _ATOM

    def lines(self, block: list[Any], depth: int = 1) -> list[str]:
        """Lines of statements."""
        pad = "    " * depth
        found: list[str] = []
        for item in block:
            if isinstance(item, Assign):
                self.variables.setdefault(item.name.id, self.kind(item.name.kind))
                if item.value is not None:
                    found.append(f"{pad}{item.name.id} := {self.text(item.value)};")
            elif isinstance(item, Store):
                place = f"{item.array.id}[{self.text(item.index)}]"
                found.append(f"{pad}{place} := {self.text(item.value)};")
            elif isinstance(item, If):
                found.append(f"{pad}IF {self.text(item.condition)} THEN")
                found += self.lines(item.body, depth + 1)
                if item.orelse:
                    found.append(f"{pad}ELSE")
                    found += self.lines(item.orelse, depth + 1)
                found.append(f"{pad}END_IF;")
            elif isinstance(item, For):
                self.variables.setdefault(item.name.id, "DINT")
                last = self.text(item.count - 1 if known(item.count) else item.count)
                more = "" if known(item.count) else " - 1"
                found.append(f"{pad}FOR {item.name.id} := 0 TO {last}{more} DO")
                found += self.lines(item.body, depth + 1)
                found.append(f"{pad}END_FOR;")
        return found


def st_source(program: Program, real: str = "double") -> str:
    """Return the function block of a program.

    Parameters
    ----------
    program : Program
    real : {"double", "float"}
        LREAL or REAL.

    Returns
    -------
    str
        One function block; its state starts at the values that stand in it.
    """
    printer = StPrinter(real)
    body = printer.lines(program.body)
    body += [
        f"    {p.name} := {printer.text(v)};"
        for p, v in zip(program.outputs, program.results, strict=True)
    ]
    body += [f"    {n.id} := {printer.text(v)};" for n, v in program.after]
    own = {n.id for n, _ in program.state}
    state = [f"    {n.id} : {printer.kind(n.kind)} := {printer.number(v)};" for n, v in
             program.state]  # fmt: skip
    state += [
        f"    {a.id} : ARRAY[0..{a.size - 1}] OF {printer.real} := "
        f"[{a.size}({printer.number(float(v))})];"
        for a, v in program.arrays
    ]
    tables = [
        f"    {a.id} : ARRAY[0..{a.size - 1}] OF {printer.real} := "
        f"[{', '.join(printer.number(v) for v in a.values or ())}];"
        for a in program.tables()
    ]
    temporary = [f"    {n} : {kind};" for n, kind in printer.variables.items() if n not in own]
    ports = [
        [f"    {p.name} : {printer.real}; (* [{ascii_text(p.unit)}] {ascii_text(p.text)} *)"
         for p in side]
        for side in (program.inputs, program.outputs)
    ]  # fmt: skip
    notes = [ascii_text(line).replace("(*", "( *").replace("*)", "* )") for line in program.notes]
    return "\n".join(
        [
            *(f"(* {line} *)" for line in notes),
            f"FUNCTION_BLOCK {program.name}",
            *_section("VAR_INPUT", ports[0]),
            *_section("VAR_OUTPUT", ports[1]),
            *_section("VAR", state),
            *_section("VAR CONSTANT", tables),
            *_section("VAR_TEMP", temporary),
            "",
            *body,
            "END_FUNCTION_BLOCK",
            "",
        ]
    )


def _section(head: str, lines: list[str]) -> list[str]:
    return [head, *lines, "END_VAR"] if lines else []
