"""A program as a function block in Structured Text, IEC 61131-3."""

from math import isfinite
from typing import Any

from dmptm_ctrl.export import program as ir
from dmptm_ctrl.export.printer import ATOM, LEVEL, UNARY, Printer, in_float


class StPrinter(Printer):
    """Prints Structured Text; collects the variables that statements set."""

    types = {"double": "LREAL", "float": "REAL", ir.INT: "DINT", ir.BOOL: "BOOL"}  # noqa: RUF012
    signs = {"or": "OR", "and": "AND", "==": "=", "!=": "<>", "neg": "-", "not": "NOT "}  # noqa: RUF012
    set_to, output, truth = ":=", "", ("FALSE", "TRUE")
    words = {"if": "IF {} THEN", "else": "ELSE", "end if": "END_IF;", "end for": "END_FOR;"}  # noqa: RUF012

    def __init__(self, real: str) -> None:
        super().__init__(real)
        self.variables: dict[str, str] = {}

    def cast(self, value: Any, kind: str) -> tuple[str, int]:
        name = "LREAL_TO_REAL" if kind == ir.REAL else "REAL_TO_LREAL"
        return f"{name}({self.text(value)})", ATOM

    def literal(self, value: float, short: bool) -> str:
        if not isfinite(value):
            raise ValueError(f"Structured Text has no literal for {value}")
        mantissa, sign, exponent = repr(in_float(value) if short else value).partition("e")
        if "." not in mantissa:
            mantissa += ".0"
        return mantissa + (f"E{exponent}" if sign else "")

    def operation(self, op: str, args: tuple[Any, ...], kind: str) -> tuple[str, int]:
        if op == "mod":
            a, n = self.text(args[0], LEVEL["*"]), self.text(args[1], UNARY)
            return f"(({a} MOD {n}) + {n}) MOD {n}", LEVEL["*"]
        both = ir.widest(args)
        if op == "floor":  # the standard rounds towards zero only
            x, real = self.text(args[0]), f"DINT_TO_{self.kind(both)}"
            down = f"{real}(TRUNC({x})) > {self.text(args[0], LEVEL['+'])}"
            return f"TRUNC({x}) - BOOL_TO_DINT({down})", LEVEL["-"]
        name = {"log": "LN", "pow": "EXPT", "real": f"DINT_TO_{self.kind(kind)}"}
        text = f"{name.get(op, op.upper())}({', '.join(self.text(a, 0, both) for a in args)})"
        level = ATOM
        if op == "tanh":  # the standard has none
            text = f"1.0 - 2.0 / (EXP(2.0 * {self.text(args[0], UNARY)}) + 1.0)"
            level = LEVEL["-"]
        if self.narrow and both == ir.WIDE and kind == ir.REAL:
            return f"LREAL_TO_REAL({text})", ATOM
        return text, level

    def assignment(self, item: ir.Assign) -> list[str]:
        self.variables.setdefault(item.name.id, self.kind(item.name.kind))
        if item.value is None:
            return []
        return [f"{item.name.id} := {self.text(item.value, 0, item.name.kind)};"]

    def loop(self, item: ir.For) -> str:
        self.variables.setdefault(item.name.id, "DINT")
        last = self.text(item.count - 1) if ir.known(item.count) else f"{self.text(item.count)} - 1"
        return f"FOR {item.name.id} := 0 TO {last} DO"


def st_source(program: ir.Program, real: str = "double") -> str:
    """Return a program as one function block; its state starts at the values that stand in it."""
    printer = StPrinter(real)
    body = printer.step(program)
    own = {n.id for n, _ in program.state}
    state = [f"    {n.id} : {printer.kind(n.kind)} := {printer.number(v)};" for n, v in
             program.state]  # fmt: skip
    state += [
        f"    {a.id} : ARRAY[0..{a.size - 1}] OF {printer.kind(ir.REAL)} := "
        f"[{a.size}({printer.number(float(v))})];"
        for a, v in program.arrays
    ]
    tables = [
        f"    {a.id} : ARRAY[0..{a.size - 1}] OF {printer.kind(ir.REAL)} := "
        f"[{', '.join(printer.number(v) for v in a.values or ())}];"
        for a in program.tables()
    ]
    temporary = [f"    {n} : {kind};" for n, kind in printer.variables.items() if n not in own]
    inputs, outputs = (
        [f"    {p.name} : {printer.kind(p.kind)}; (* {ir.ascii_text(f'[{p.unit}] {p.text}')} *)"
         for p in side]
        for side in (program.inputs, program.outputs)
    )  # fmt: skip
    return "\n".join(
        [
            *(f"(* {ir.ascii_text(line)} *)" for line in program.notes),
            f"FUNCTION_BLOCK {program.name}",
            *_section("VAR_INPUT", inputs),
            *_section("VAR_OUTPUT", outputs),
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
