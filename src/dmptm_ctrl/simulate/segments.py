"""Lines of a step as loops over lanes, which become vector code.

What follows each other without a condition is one loop, what stands behind a flag another.
What one loop hands on to the next stands in rows of a work array. Each is a function of its own:
the time to compile one grows faster than its length.
"""

import ast
import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

# a record of numbers has no row: where a later loop needs it, it is made again
RECORDS = ("Backlash", "Stribeck")
ON = r"on\[(\d+)\]"  # condition: whether an effect acts
SOME = r"some\((\w+)\)"  # condition: whether a row has a positive number in any lane
PASSING = "c"  # what a kernel returned, used up at once


class Segment(NamedTuple):
    """One loop: its condition or none, its lines, what it takes from rows and leaves there."""

    condition: str
    lines: list[str]
    takes: list[str]
    leaves: list[str]

    def function(self, name: str, at: Callable[[str], str]) -> str:
        """Text of the loop as a function; `at` gives the text of a row."""
        body = [f"{name} = {at(name)}" for name in self.takes]
        body += [*self.lines, *(f"{at(name)} = {name}" for name in self.leaves)]
        rows = "".join(f"        {line}\n" for line in body)
        return f"def {name}(w, t, h):\n    wide()\n    for lane in range(LANES):\n{rows}"

    @property
    def flags(self) -> list[int]:
        """Flags of effects of which one has to act."""
        return [int(flag) for flag in re.findall(ON, self.condition)]

    @property
    def row(self) -> str | None:
        """Row of which a number has to be positive."""
        found = re.search(SOME, self.condition)
        return found and found[1]


def segments(lines: Iterable[str], rows: Iterable[str], kept: Iterable[str]) -> list[Segment]:
    """Cut lines of a function's body into loops.

    They are indented by four; ``if`` lines have blocks behind them. Names in `rows` stand there
    beforehand, those `kept` are to stand there afterwards.
    """
    parts = _with_records(_in_order(_cut(lines)))
    named = [_names_of(part) for part in parts]
    known = set(rows).union(*(written for _, written in named)) - {PASSING, *_records(parts)}
    found: list[Segment] = []
    later = set(kept)
    for (condition, body), (read, written) in zip(reversed(parts), reversed(named), strict=True):
        leaves = [name for name in written if name in later and name in known]
        takes = [name for name in read if name in known]
        found.insert(0, Segment(condition, body, takes, leaves))
        later |= set(takes)
    return found


def _cut(lines: Iterable[str]) -> list[tuple[str, list[str]]]:
    """Each line, and each condition with the lines behind it."""
    parts: list[tuple[str, list[str]]] = []
    for line in (line[4:] for line in lines):
        if line.startswith("if "):
            parts.append((line, []))
        elif line.startswith(" "):
            parts[-1][1].append(line.strip())
        else:
            parts.append(("", [line]))
    return parts


def _in_order(parts: list[tuple[str, list[str]]]) -> list[tuple[str, list[str]]]:
    """Put parts as early as what they need allows, so that there are few loops.

    Then lines as late as what needs them allows, so that little has to be handed on.
    """
    stage: list[int] = []
    needs: list[list[int]] = []
    wrote: dict[str, int] = {}  # name -> part that wrote it last, and parts that have read it
    uses: dict[str, list[int]] = {}
    for k, (condition, body) in enumerate(parts):
        read, written = (
            set(names) - {PASSING if condition else ""} for names in _names_of((condition, body))
        )
        before = [wrote[name] for name in read | written if name in wrote]
        before += [j for name in written for j in uses.get(name, ())]
        needs.append(before)
        # a condition's part comes behind the lines of its stage
        stage.append(
            max((stage[j] + (not condition and bool(parts[j][0])) for j in before), default=0)
        )
        for name in written:
            wrote[name], uses[name] = k, []
        for name in read:
            uses.setdefault(name, []).append(k)
    last = max(stage, default=-1)
    latest = [last] * len(parts)
    for k in reversed(range(len(parts))):
        if not parts[k][0]:
            stage[k] = latest[k]
        for j in needs[k]:
            latest[j] = min(latest[j], stage[k])
    found: list[tuple[str, list[str]]] = []
    for number in range(last + 1):
        own = [part for part, at in zip(parts, stage, strict=True) if at == number]
        lines = [line for condition, body in own if not condition for line in body]
        found += [("", lines)] if lines else []
        found += [part for part in own if part[0]]
    return found


def _records(parts: list[tuple[str, list[str]]]) -> dict[str, str]:
    """Lines that make a record, by its name."""
    made = [line for _, body in parts for line in body]
    return {
        line.split(" = ")[0]: line
        for line in made
        if line.split(" = ")[1].startswith(tuple(f"{record}(" for record in RECORDS))
    }


def _with_records(parts: list[tuple[str, list[str]]]) -> list[tuple[str, list[str]]]:
    """Make records again in each part that uses them."""
    records = _records(parts)
    found = []
    for condition, body in parts:
        here: list[str] = []
        made: set[str] = set()
        for line in body:
            read, written = _names([line])
            for name in read:
                if name in records and name not in made:
                    here.append(records[name])
                    made.add(name)
            here.append(line)
            made |= set(written)
        found.append((condition, here))
    return found


def _names_of(part: tuple[str, list[str]]) -> tuple[list[str], list[str]]:
    """Names that a part reads, those of its condition too, and those that it writes."""
    condition, body = part
    read, written = _names(body)
    return [*re.findall(SOME, condition), *read], written


def _names(lines: list[str]) -> tuple[list[str], list[str]]:
    """Names that lines read before they write them, and those that they write, in order."""
    read: dict[str, None] = {}
    written: dict[str, None] = {}
    for line in lines:
        names = [node for node in ast.walk(ast.parse(line)) if isinstance(node, ast.Name)]
        for node in names:
            if isinstance(node.ctx, ast.Load) and node.id not in written:
                read[node.id] = None
        for node in names:
            if isinstance(node.ctx, ast.Store):
                written[node.id] = None
    return list(read), list(written)
