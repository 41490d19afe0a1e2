"""Pieces of text that slopes of kernels are written of; what is known by name."""

import ast
import math
import re
from typing import Any, NamedTuple

import numpy as np

NEAR = 1e-6  # of the values compared: nearer to each other than this, a branch is not sure
# Slopes of what is known by name: of the value {v}, of the argument {x}
KNOWN = {
    "exp": "{v}",
    "log": "1.0 / {x}",
    "sqrt": "0.5 / {v}",
    "tanh": "1.0 - {v} * {v}",
}
_NAMES = (*KNOWN, "sin", "cos", "floor")
FUNCTIONS: dict[Any, str] = {getattr(module, n): n for module in (math, np) for n in _NAMES}
FUNCTIONS |= {f: f.__name__ for f in (abs, min, max, int)} | {np.abs: "abs", math.fabs: "abs"}
OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%", ast.Pow: "**"}

# An argument; the position in a record, or its name if found; the number of such a value
Seed = str | tuple[str, int | str] | int
Tangents = dict[Seed, str]  # how a value changes with what it depends on
Dual = tuple[str, Tangents]  # text of a value, with that of its slopes


class NoSlopes(Exception):
    """A kernel whose slopes cannot be written: source that is not kept, or not covered."""


class Slopes(NamedTuple):
    """A function that returns values and slopes.

    Its text returns values; slopes by `motion`, of one value after the other; slopes by `fields`;
    positions in the record that are found while it runs; slopes by these; whether a small change
    leaves all branches as they are, that of a field in `deciding` apart. With `rests` it takes one
    more argument for each in `motion`: whether that does not change at all. For each record in
    `looked_in` it takes two more: an array, and where in it the record begins; of many numbers
    held as a tuple each would be fetched, to have one by its place.
    """

    name: str
    text: str
    values: int
    motion: tuple[str, ...]
    fields: tuple[tuple[str, int], ...]
    found: int
    record: str
    deciding: frozenset[tuple[str, int]]
    looked_in: tuple[str, ...]


def looked_up_in(record: str) -> list[str]:
    """Return arguments by which a function finds what it looks up in a record."""
    return [f"{record}_in", f"{record}_from"]


def is_simple(text: str) -> bool:
    return re.fullmatch(r"[\w.]+", text) is not None


def times(a: str, b: str) -> str:
    """Product of two texts."""
    for x, y in ((a, b), (b, a)):
        if x == "1.0":
            return y
        if x == "-1.0":
            return f"(-{y})"
    return f"({a} * {b})"


def row_of(parts: list[str]) -> str:
    return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"


def as_float(text: str) -> str:
    return f"{text}.0" if re.fullmatch(r"-?\d+", text) else text


def far_apart(a: str, b: str, size: str = "") -> str:
    """Text of whether two values are apart by more than a small change."""
    if b in ("0", "0.0") and not size:
        return f"{a} != 0.0"
    return f"abs({a} - {b}) > {NEAR} * ({f'abs({size})' if size else f'abs({a}) + abs({b})'})"
