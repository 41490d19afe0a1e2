"""A program as C99: one header, one source, no allocation and nothing but the C library's maths."""

from collections.abc import Mapping
from math import isinf, isnan
from typing import Any, NamedTuple

from dmptm_ctrl.export import program as ir
from dmptm_ctrl.export.printer import ATOM, LEVEL, REALS, UNARY, Printer, in_float

_PYTHON = {ir.REAL: float, ir.WIDE: float, ir.INT: int, ir.BOOL: bool}  # types of the kinds


class _Choice(NamedTuple):
    test: Any
    first: Any
    second: Any


def _chosen(block: list[Any]) -> list[Any]:
    """Give the block with C's ternary in place of a branch that only sets one new name."""
    found: list[Any] = []
    for item in block:
        last = found[-1] if found else None
        if isinstance(item, ir.If) and isinstance(last, ir.Assign) and last.value is None:
            sides = [side[0] for side in (item.body, item.orelse) if len(side) == 1]
            if len(sides) == 2 and all(
                isinstance(s, ir.Assign) and s.name == last.name and not s.declare for s in sides
            ):
                choice = _Choice(item.condition, sides[0].value, sides[1].value)
                found[-1] = ir.Assign(last.name, choice)
                continue
        found.append(item)
    return found


class CPrinter(Printer):
    """Prints C; `names` are those of variables that stand in the state, and of tables.

    `prefix` is put before the names of functions of whole numbers.
    """

    types = {real: real for real in REALS} | {ir.INT: "int32_t", ir.BOOL: "bool"}
    signs = {"or": "||", "and": "&&", "neg": "-", "not": "!"}  # noqa: RUF012
    set_to, output, truth = "=", "*", ("false", "true")
    words = {"if": "if ({}) {{", "else": "} else {", "end if": "}", "end for": "}"}  # noqa: RUF012

    def __init__(self, real: str, names: Mapping[str, str] | None = None, prefix: str = "") -> None:
        super().__init__(real)
        self.names, self.prefix = names or {}, prefix

    def cast(self, value: Any, kind: str) -> tuple[str, int]:
        return f"({self.kind(kind)}){self.text(value, UNARY)}", UNARY

    def operation(self, op: str, args: tuple[Any, ...], kind: str) -> tuple[str, int]:
        if op == "mod":  # as Python's, of the divisor's sign
            a, n = self.text(args[0], LEVEL["*"]), self.text(args[1], UNARY)
            if isinstance(args[0], ir.Name) and args[0].counts:
                return f"{a} % {n}", LEVEL["*"]
            return f"({a} % {n} + {n}) % {n}", LEVEL["*"]
        if op == "real":
            inner = args[0]
            if isinstance(inner, ir.Op) and inner.op == "floor":
                return self._function("floor", inner.args), ATOM
            return f"({self.kind(kind)}){self.text(inner, UNARY)}", UNARY
        if op == "trunc":
            return f"(int32_t){self.text(args[0], UNARY)}", UNARY
        if op == "floor":
            return f"(int32_t){self._function('floor', args)}", UNARY
        if kind == ir.INT and op in _OF_INTEGERS:
            return f"{self.prefix}{op}_int({', '.join(self.text(a) for a in args)})", ATOM
        name = {"min": "fmin", "max": "fmax", "abs": "fabs"}.get(op, op)
        if self.narrow and kind == ir.REAL and ir.widest(args) == ir.WIDE:
            return f"(float){self._function(name, args)}", UNARY
        return self._function(name, args), ATOM

    def _function(self, name: str, args: tuple[Any, ...]) -> str:
        kind = ir.widest(args)
        suffix = "f" if self.narrow and kind != ir.WIDE else ""
        return f"{name}{suffix}({', '.join(self.text(a, 0, kind) for a in args)})"

    def name(self, name: str) -> str:
        return self.names.get(name, name)

    def literal(self, value: float, short: bool) -> str:
        if isnan(value):
            return "NAN"
        if isinf(value):
            return "INFINITY" if value > 0 else "-INFINITY"
        return f"{in_float(value)!r}f" if short else repr(value)

    def assignment(self, item: ir.Assign) -> list[str]:
        kind, value = item.name.kind, ""
        if isinstance(item.value, _Choice):
            a, b = (self.text(v, 1, kind) for v in item.value[1:])
            value = f" = {self.text(item.value.test, 1)} ? {a} : {b}"
        elif item.value is not None:
            value = f" = {self.text(item.value, 0, kind)}"
        new = f"{self.kind(kind)} " if item.declare else ""
        return [f"{new}{self.name(item.name.id)}{value};"]

    def loop(self, item: ir.For) -> str:
        k = item.name.id
        return f"for (int32_t {k} = 0; {k} < {self.text(item.count)}; {k}++) {{"

    def lines(self, block: list[Any], depth: int = 1) -> list[str]:
        return super().lines(_chosen(block), depth)


def c_header(program: ir.Program, real: str = "double") -> str:
    """Return the header: the state, and the two functions that work on it."""
    name = program.name
    guard = f"{name.upper()}_H"
    printer = CPrinter(real)
    fields = [f"    {printer.kind(n.kind)} {n.id};" for n, _ in program.state]
    fields += [f"    {real} {a.id}[{a.size}];" for a, _ in program.arrays]
    fields = fields or ["    char unused;"]
    ports = [f"{p.name} [{p.unit}]: {p.text}" for p in (*program.inputs, *program.outputs)]
    return "\n".join(
        [
            *_comment(program.notes),
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <stdbool.h>",
            "#include <stdint.h>",
            "",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            "typedef struct {",
            *fields,
            f"}} {name}_state;",
            "",
            "/* Call once before the first step. */",
            f"void {name}_init({name}_state *state);",
            "",
            "/* Call once per sample.",
            *(f" *   {line}" for line in map(ir.ascii_text, ports)),
            " */",
            f"{_signature(program, real)};",
            "",
            "#ifdef __cplusplus",
            "}",
            "#endif",
            "",
            f"#endif /* {guard} */",
            "",
        ]
    )


def c_source(program: ir.Program, real: str = "double") -> str:
    """Return the source that belongs to :func:`c_header`."""
    name = program.name
    kept = [n.id for n, _ in program.state] + [a.id for a, _ in program.arrays]
    names = {key: f"state->{key}" for key in kept}
    # of the whole file: another program may stand beside it
    names |= {a.id: f"{name}_{a.id}" for a in program.tables()}
    printer = CPrinter(real, names, f"{name}_")
    first = [
        f"    state->{n.id} = {printer.number(_PYTHON[n.kind](value), n.kind)};"
        for n, value in program.state
    ]
    for array, value in program.arrays:
        first.append(f"    for (int32_t k = 0; k < {array.size}; k++) {{")
        first += [f"        state->{array.id}[k] = {printer.number(float(value))};", "    }"]
    first = first or ["    state->unused = 0;"]
    body = printer.step(program)
    unused = [] if kept else ["    (void)state;"]
    text = "\n".join(body)
    unused += [f"    (void){p.name};" for p in program.inputs if p.name not in text]
    return "\n".join(
        [
            *_comment(program.notes),
            f'#include "{name}.h"',
            "",
            "#include <math.h>",
            "",
            *c_helpers(text, f"{name}_"),
            *(c_table(a, printer) for a in program.tables()),
            "",
            f"void {name}_init({name}_state *state) {{",
            *first,
            "}",
            "",
            f"{_signature(program, real)} {{",
            *unused,
            *body,
            "}",
            "",
        ]
    )


def _signature(program: ir.Program, real: str) -> str:
    parts = [f"{program.name}_state *state"]
    kind = CPrinter(real).kind
    parts += [f"{kind(p.kind)} {p.name}" for p in program.inputs]
    parts += [f"{kind(p.kind)} *{p.name}" for p in program.outputs]
    return f"void {program.name}_step(\n    " + ",\n    ".join(parts) + ")"


def _comment(notes: list[str]) -> list[str]:
    return (
        ["/*", *(f" * {line}".rstrip() for line in map(ir.ascii_text, notes)), " */"]
        if notes
        else []
    )


_OF_INTEGERS = {
    "min": ("int32_t a, int32_t b", "a < b ? a : b"),
    "max": ("int32_t a, int32_t b", "a > b ? a : b"),
    "abs": ("int32_t a", "a < 0 ? -a : a"),
}


def c_helpers(text: str, prefix: str) -> list[str]:
    """Functions of whole numbers that a text calls."""
    found = []
    for op, (args, body) in _OF_INTEGERS.items():
        if f"{prefix}{op}_int(" in text:
            found += [f"static int32_t {prefix}{op}_int({args}) {{ return {body}; }}", ""]
    return found


def c_table(array: ir.Array, printer: CPrinter) -> str:
    """A constant table."""
    values = array.values or ()
    rows = [
        "    " + ", ".join(printer.number(v) for v in values[k : k + 4]) + ","
        for k in range(0, len(values), 4)
    ]
    name = printer.name(array.id)
    return "\n".join([f"static const {printer.real} {name}[{array.size}] = {{", *rows, "};"])
