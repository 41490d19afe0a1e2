"""What a long command says meanwhile: a line that moves, or JSON lines for programs."""

import json
import sys
import time
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from dmptm_ctrl.signals.info import LogInfo


class Progress:
    """Stages of a command, on standard error; `quiet` for warnings only.

    As JSON an object per line: ``event`` ("stage", "warning", "done"), ``seconds`` since the
    start, and what belongs to the event. Else a line with a clock, on a terminal.
    """

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        self._start = time.perf_counter()
        self._json = as_json
        self._moving = sys.stderr.isatty() and not quiet and not as_json
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        if self._moving:
            from rich import progress
            from rich.console import Console

            columns = progress.SpinnerColumn(), "{task.description}", progress.TimeElapsedColumn()
            self._bar = progress.Progress(
                *columns, console=Console(stderr=True), transient=True, refresh_per_second=4
            )
            self._task = self._bar.add_task("", total=None)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def stage(self, text: str) -> None:
        """Say what is being done now."""
        if self._bar is not None:
            self._bar.update(self._task, description=text)
        self._line("stage", text=text)

    def warn(self, text: str) -> None:
        """Tell a warning, also when quiet."""
        if self._json:
            self._line("warning", text=text)
        elif self._bar is not None:
            self._bar.console.print(f"warning: {text}", markup=False, highlight=False)
        else:
            print(f"warning: {text}", file=sys.stderr)  # noqa: T201

    def done(self, **result: Any) -> None:
        """Say that all is written, and what came out."""
        self._line("done", **result)

    def _line(self, event: str, **what: Any) -> None:
        if self._json:
            seconds = round(time.perf_counter() - self._start, 3)
            line = json.dumps({"event": event, "seconds": seconds, **what}, ensure_ascii=False)
            print(line, file=sys.stderr, flush=True)  # noqa: T201


def show_info(info: "LogInfo", *, declared: bool = True) -> None:
    """Print what is in a log, and what it can and cannot identify; `declared`: by a rig file."""
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True)
    rate = f", {info.duration:.6g} s at {1 / info.sample_time:.6g} Hz" if info.duration else ""
    console.print(f"[bold]{_plain(info.name)}[/bold]: {info.samples} samples{rate}")
    table = Table("channel", "min", "max", "rms", "resolution", box=None)
    for channel in info.channels:
        numbers = (channel.low, channel.high, channel.rms, channel.resolution)
        table.add_row(_plain(channel.column), *(f"{number:.5g}" for number in numbers))
    console.print(table)
    for warning in info.warnings:
        console.print(f"warning: {_plain(warning)}")
    if info.excitation is None:
        console.print(
            "No input with a motion is known by its unit: a rig file says what the columns are "
            "(dmptm rig init writes one)."
        )
        return
    if not info.testable:
        excited = info.excitation
        console.print(
            f"\n99 % of the input's power lie below {excited.bandwidth:.3g} Hz. The motion "
            f"reverses {excited.reversals} times and stops {excited.stops} times.\nWhich effects "
            "a log can show depends on the drive: give its rig file with --rig (dmptm rig init "
            "writes one)."
        )
        return
    if not declared:
        console.print("\nThe columns are those of the dual-motor drive; so are these effects.")
    can = [row.effect for row in info.testable if row.testable]
    console.print(f"\n[bold]Can identify[/bold] {', '.join(can) or 'nothing'}")
    console.print("[bold]Cannot identify[/bold]")
    lacking = Table("effect", "lacks", box=None)
    for row in info.testable:
        if not row.testable:
            lacking.add_row(row.effect, "; ".join(row.lacks))
    console.print(lacking)


def printable(text: str) -> str:
    """Text of a file without control characters."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


def _plain(text: str) -> str:
    """Text of a file, shown as it is: no markup, no control characters, one line."""
    from rich.markup import escape

    return escape(printable(text).replace("\n", "?"))
