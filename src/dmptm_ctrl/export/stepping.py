"""A step of a controller or plant, made a program with its state."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import dmptm_ctrl
from dmptm_ctrl.export.program import INT, Assign, Name, Program, known, make, prune
from dmptm_ctrl.export.tracer import Tracer

LAST_SAMPLE = 2**31 - 2  # the count of samples stays there


def counter(tracer: Tracer) -> Name:
    """Return the number of the sample, from 0."""
    return replace(tracer.fresh("samples", INT), counts=True)


def finished(
    tracer: Tracer,
    program: Program,
    samples: Name,
    carried: list[tuple[Name, Any, Any]],
    *,
    before: list[Any] | None = None,
) -> Program:
    """Return a program with its state, and statements `before` it; without what nothing needs.

    `carried` are (name, value at the start, value behind the step), of `Scope.turning`.
    """
    state = [(name, old) for name, old, _ in carried]
    after = [(name, new) for name, _, new in carried]
    state.append((samples, 0))
    after.append((samples, make("min", make("+", samples, 1), LAST_SAMPLE)))
    body = [*(before or []), *program.body]
    whole = replace(program, state=state, after=after, body=body, arrays=tracer.arrays)
    return _separated(tracer, prune(whole))


def _separated(tracer: Tracer, program: Program) -> Program:
    """Return the program with new values of the state that none overwrites before it is read."""
    kept = {name.id for name, _ in program.after}
    body, found = list(program.body), []
    for name, value in program.after:
        if not known(value) and value != name and not (
            isinstance(value, Name) and value.id not in kept
        ):  # fmt: skip
            spare = tracer.fresh(f"new_{name.id}", name.kind)
            body.append(Assign(spare, value))
            value = spare
        found.append((name, value))
    return replace(program, body=body, after=found)


def word(name: str) -> str:
    """Return a name as a program has it; IEC 61131-3 takes no two underlines on end."""
    return re.sub("[^0-9A-Za-z]+", "_", name).strip("_").lower()


def origin(source: Path | None) -> list[str]:
    """Return the comment lines that say what wrote a file, and from what."""
    lines = [f"Written by dmptm-ctrl {dmptm_ctrl.__version__}."]
    if source is not None:
        digest = hashlib.sha256(source.read_bytes()).hexdigest()
        lines.append(f"Source: {source.name}, SHA-256 {digest}.")
    return lines
