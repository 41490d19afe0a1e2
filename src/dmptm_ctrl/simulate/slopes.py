"""Slopes of kernels, written as source text from the source of the kernels.

Differentiation of the text (Griewank & Walther, Evaluating Derivatives, 2008, ch. 3 and 10): each
line is followed by those of its slopes; sines, cosines and exponentials are taken once for value
and slopes. A value that depends on more than a few goes on as something to depend on itself, and
is put in its place at the end. Branches stay as they are, and where a comparison is too close to
say that a small change leaves the branch, the text says so. What is not covered raises
:class:`NoSlopes`.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from dmptm_ctrl.simulate.slope_text import NoSlopes, Slopes
from dmptm_ctrl.simulate.slope_writer import Writer


class Library:
    """Texts of functions with slopes, each once."""

    def __init__(self) -> None:
        self.known: dict[Any, Slopes] = {}

    def of(
        self,
        function: Callable[..., Any],
        motion: Sequence[str],
        records: Mapping[str, Sequence[str]],
        *,
        speeds: Iterable[str] | None = (),
        still: Iterable[tuple[str, str | int]] = (),
        chosen: Iterable[tuple[str, int]] = (),
    ) -> Slopes:
        """Write a function with slopes by the arguments `motion` and what is in `records`.

        Parameters
        ----------
        records : mapping
            Argument → names of its fields, empty for a tuple.
        speeds : iterable of str, or None
            Arguments in `motion` that do not change where they are zero: what rests stays at
            rest. None: the caller says which do not.
        still : iterable of (argument, field or position)
            What does not change.
        chosen : iterable of (argument, position)
            What is chosen once for a run, and may be compared without being close to anything.
        """
        function = getattr(function, "py_func", function)
        rests = (
            {a: f"rests_{a}" for a in motion}
            if speeds is None
            else {a: f"({a} == 0.0)" for a in speeds}
        )
        key = (function, tuple(motion), tuple(records), *map(tuple, (rests, still, chosen)))
        if key not in self.known:
            name = f"{function.__name__}_slopes_{len(self.known)}"
            name = re.sub(r"\W", "_", name)
            try:
                writer = Writer(self, function, motion, records, rests, set(still), set(chosen))
                self.known[key] = writer.slopes(name)
            except (LookupError, TypeError, ValueError, RecursionError) as error:
                raise NoSlopes(f"{name} is not covered: {error}") from error
        return self.known[key]

    def text(self) -> str:
        """Text of all functions, those that are called before those that call."""
        return "\n\n\n".join(slopes.text for slopes in self.known.values())
