"""Exported text made to run: C by the system's compiler, Structured Text line by line in Python."""

import ctypes
import math
import re
import subprocess
from types import SimpleNamespace

import pytest

from dmptm_ctrl.export.c_source import CPrinter, c_header, c_helpers, c_source, c_table
from dmptm_ctrl.export.native import FLAGS, compiler
from dmptm_ctrl.export.program import Array, Port, Program, prune
from dmptm_ctrl.export.trace import follow, function_tree
from dmptm_ctrl.export.tracer import Tracer

COMPILER = compiler()
STRICT = (
    *("-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow", "-Wconversion", "-Wsign-conversion"),
    *("-Wdouble-promotion", "-Wundef", "-Wcast-qual", "-Wredundant-decls"),
)
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


def c_function(function, name, known=None, records=None):
    """A scalar Python function as ``void name(const double *in, double *out, …)``.

    `known`: argument -> its value. `records`: argument -> field names of a NamedTuple, which is
    read from an array of its own behind `out`.
    """
    known, records, tracer, body = known or {}, records or {}, Tracer(), []
    args, free, pointers = [], [], []
    for argument in function_tree(getattr(function, "py_func", function)).args.args:
        key = argument.arg
        if key in known:
            args.append(known[key])
        elif key in records:
            array = Array(tracer.fresh(f"{key}_values").id, len(records[key]), None, records[key])
            pointers.append(array.id)
            args.append(array)
        else:
            args.append(tracer.fresh(key))
            free.append(args[-1].id)
    with tracer.collected(body):
        result = follow(tracer, function, args)
    results = list(result) if isinstance(result, tuple) else [result]
    program = prune(Program(name, [], [Port("", "", "")] * len(results), results, [], body, []))
    printer = CPrinter("double")
    lines = [f"    double {key} = in[{k}];" for k, key in enumerate(free)]
    lines += [f"    (void){key};" for key in (*free, *pointers, "in")]
    lines += printer.lines(program.body)
    lines += [f"    out[{k}] = {printer.text(v)};" for k, v in enumerate(program.results)]
    more = "".join(f", const double *{p}" for p in pointers)
    head = ["#include <math.h>", "#include <stdbool.h>", "#include <stdint.h>"]
    head += [*c_helpers("\n".join(lines), ""), *(c_table(a, printer) for a in program.tables())]
    head.append(f"void {name}(const double *in, double *out{more}) {{")
    return "\n".join([*head, *lines, "}", ""])


def compile_c(folder, name, source, header=None):
    """Shared library of a C text, without a warning."""
    if header is not None:
        (folder / f"{name}.h").write_text(header, encoding="ascii")
    file = folder / f"{name}.c"
    file.write_text(source, encoding="ascii")
    library = folder / f"lib{name}_{len(list(folder.iterdir()))}.so"  # one of a name loads once
    subprocess.run([COMPILER, *STRICT, *FLAGS, str(file), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def warns_of_nothing(folder, program, real="double"):
    """Compile a program's C as strictly as the compiler can."""
    compile_c(folder, program.name, c_source(program, real), c_header(program, real))


WORDS = {"AND": "and", "OR": "or", "NOT": "not", "TRUE": "True", "FALSE": "False", "MOD": "%"}
FUNCTIONS = {
    "EXP": math.exp, "LN": math.log, "SIN": math.sin, "COS": math.cos, "TAN": math.tan,
    "SQRT": math.sqrt, "ABS": abs, "MIN": min, "MAX": max, "EXPT": pow, "TRUNC": math.trunc,
    "LREAL_TO_REAL": float, "REAL_TO_LREAL": float, "DINT_TO_LREAL": float,
    "DINT_TO_REAL": float, "BOOL_TO_DINT": int,
}  # fmt: skip


def expression(text):
    """Python's text of an expression of Structured Text."""
    text = re.sub(r"\b[A-Z]+\b", lambda word: WORDS.get(word[0], word[0]), text)
    return text.replace("<>", "!=").replace(" = ", " == ")


def translated(text):
    """Python's text of a function block's body, line by line."""
    lines, depth = [], 0
    for line in text.splitlines():
        line = line.strip().rstrip(";")
        if line in ("END_IF", "END_FOR"):
            depth -= 1
            continue
        if line == "ELSE":
            lines.append(f"{' ' * (depth - 1)}else:")
            continue
        if found := re.fullmatch(r"IF (.*) THEN", line):
            lines.append(f"{' ' * depth}if {expression(found[1])}:")
            depth += 1
        elif found := re.fullmatch(r"FOR (\w+) := 0 TO (.*) DO", line):
            last = expression(found[2])
            lines.append(f"{' ' * depth}for {found[1]} in range({last} + 1):")
            depth += 1
        elif found := re.fullmatch(r"(.+?) := (.*)", line):
            lines.append(f"{' ' * depth}{expression(found[1])} = {expression(found[2])}")
        elif line:
            raise ValueError(f"not of the subset: {line}")
    return "\n".join(lines)


def st_stepper(text, outputs):
    """Function block as a function of its inputs, in the order in which they are declared."""
    text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.S)
    head = re.search(r"FUNCTION_BLOCK \w+\n(.*?)END_FUNCTION_BLOCK", text, re.S)
    declared, _, block = head[1].rpartition("END_VAR\n")
    sections = re.findall(r"(?<!_)(VAR[ \w]*)\n(.*?)(?=END_VAR|\Z)", declared, re.S)
    state, inputs, names = {}, [], []
    for kind, body in sections:
        for line in body.strip().splitlines():
            name, rest = line.strip().rstrip(";").split(" : ", 1)
            names.append(name.lower())
            if kind == "VAR_INPUT":
                inputs.append(name)
            _, given, first = rest.partition(" := ")
            first = re.sub(r"\[(\d+)\((.*)\)\]", r"[\2] * \1", first)
            if given:
                state[name] = eval(expression(first), {})
    assert len(set(names)) == len(names)  # a PLC does not tell upper from lower case
    code = compile(translated(block), "block", "exec")
    declared_names = set(names)

    def stepped(*values):
        own = dict(zip(inputs, values, strict=True)) | state
        exec(code, dict(FUNCTIONS), own)
        assert set(own) <= declared_names
        state.update({key: own[key] for key in state})
        return [own[name] for name in outputs]

    return SimpleNamespace(step=stepped, state=state).step
