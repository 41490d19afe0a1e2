"""What the command line calls: logs and a model file in, what has moved out."""

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from dmptm_ctrl.check.evidence import Evidence, evidence_of, only_own
from dmptm_ctrl.check.moved import (
    TOLERANCE,
    Change,
    Information,
    beside,
    disagreement,
    entries_of,
    find_moved,
    information_of,
    too_short,
)
from dmptm_ctrl.signals import Campaign, Log, LogError, load_logs
from dmptm_ctrl.signals.atomic import check_folder, output_folder
from dmptm_ctrl.signals.loaders import LEFT_OUT
from dmptm_ctrl.simulate.any_model import AnyModel
from dmptm_ctrl.simulate.model_file import read_model
from dmptm_ctrl.simulate.rig_model import RigModel

ABOVE_FLOOR = 1.5  # times the recorded error, as in the verdict "none" of the diagnosis
_DATE = re.compile(r"(20\d\d)[-_]?(\d\d)[-_]?(\d\d)(?:[T_-](\d\d)[-_:]?(\d\d)(?:[-_:]?(\d\d))?)?")


@dataclass(frozen=True, eq=False)
class Check:
    """New logs against a model."""

    moved: list[Change]  # entries that changed by more than the tolerance, the clearest first
    alone: list[Change]  # every entry, refitted alone
    torque_rms: float  # residual of the torque balance on the new logs
    floor: float | None  # the same as the diagnosis of the model left it, if recorded
    unit: str
    logs: tuple[str, ...]  # names of those that decide
    # every entry beside what moved, per date in the logs' names
    trend: dict[datetime, list[Change]]
    warnings: tuple[str, ...] = ()  # what was left out of the logs or mended

    @property
    def unexplained(self) -> bool:
        """Whether more is left than the model's own diagnosis left, and no entry says why."""
        above = self.floor is not None and self.torque_rms > ABOVE_FLOOR * self.floor
        return above and not self.moved

    @property
    def same(self) -> bool:
        """Whether it is the machine that the model describes."""
        return not self.moved and not self.unexplained

    def summary(self) -> str:
        """Return the result as text."""
        lines = [f"logs: {', '.join(self.logs)}"]
        of = "" if self.floor is None else f"; recorded for the model: {self.floor:.3g}"
        lines.append(f"residual of the torque balance: {self.torque_rms:.3g} {self.unit}{of}")
        if self.moved:
            lines.append("the machine has changed:")
            lines += [f"  {change.text()}" for change in self.moved]
        elif self.unexplained:
            lines.append(
                "the machine has changed, or is driven otherwise than for its model, and "
                "no entry of the model says how; run dmptm diagnose on these logs"
            )
        else:
            lines.append(f"still the same machine: none of {len(self.alone)} entries moved")
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    __str__ = summary

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for a JSON file."""
        return {
            "same": self.same,
            "moved": [_row(c) for c in self.moved],
            "entries": [_row(c) for c in self.alone],
            "residual": {"torque_rms": self.torque_rms, "floor": self.floor, "unit": self.unit},
            "logs": list(self.logs),
            "warnings": list(self.warnings),
            "trend": [
                {"date": date.isoformat(), "entries": [_row(c) for c in changes]}
                for date, changes in self.trend.items()
            ],
        }

    def plot(self, *, ax: Any = None) -> Any:
        """Draw the entries over the dates of the logs."""
        from dmptm_ctrl.plots.trend import plot_trend

        return plot_trend(list(self.trend), _series(self.trend), ax=ax)

    def save(self, folder: Path) -> None:
        """Write check.json, and trend.png where there are dates."""
        with output_folder(folder) as out:
            text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
            (out / "check.json").write_text(text + "\n", encoding="utf-8")
            if len(self.trend) > 1:
                self.plot().get_figure(root=True).savefig(out / "trend.png", dpi=150)


def check(
    model: AnyModel | str | Path,
    logs: Any,
    *,
    errors: Mapping[str, float] | None = None,
    floor: float | None = None,
    bandwidth: float | None = None,
    tolerance: float = TOLERANCE,
    jobs: int = 2,
) -> Check:
    """Check whether logs are of the machine that a model describes.

    Parameters
    ----------
    model : Model, RigModel or path of a model.toml
        Of a file, a diagnosis.json beside it gives `errors`, `floor` and `bandwidth`.
    logs : folder, files or Logs
    errors : mapping of parameter key to float, optional
        Standard errors of the model's parameters [SI]. A parameter that is not there is taken
        as uncertain as these logs would leave it.
    floor : float, optional
        Residual of the torque balance that the model's own diagnosis left.
    bandwidth : float, optional
        Below which it did [Hz], of rigs. These logs may allow less.
    tolerance : float
        Share of an entry's value by which it may differ.
    jobs : int
        Threads; nothing depends on it.

    Returns
    -------
    Check
        ``same``, ``moved``, ``summary()``, ``save(folder)``. Of logs with dates in their names,
        those of the newest date decide.

    Raises
    ------
    LogError
        Logs or a model file that cannot be used.

    Examples
    --------
    >>> found = dm.check("model.toml", "logs")
    >>> print(found.summary())
    """
    if isinstance(model, str | Path):
        path = Path(model)
        recorded = _recorded(path.with_name("diagnosis.json"))
        errors = {**_errors(recorded), **(errors or {})}
        if floor is None:
            floor, band = _floor(recorded)
            bandwidth = band if bandwidth is None else bandwidth
        model = read_model(path)
    loaded, notes = _loaded(model, logs)
    notes += [f"{log.name}: {text}" for log in loaded for text in log.warnings]
    dated: dict[datetime, list[Log]] = {}
    for log in loaded:
        date = date_of(log.name)
        if date is not None:
            dated.setdefault(date, []).append(log)
    dated = dict(sorted(dated.items())) or {datetime.min: list(loaded)}
    show = partial(_shown, model, errors=errors or {}, bandwidth=bandwidth, jobs=jobs)
    shown = {date: show(own) for date, own in dated.items()}
    entries = {date: entries_of(evidence.parameters) for date, (evidence, _) in shown.items()}
    found = {
        date: find_moved(information, entries[date], tolerance)
        for date, (_, information) in shown.items()
    }
    newest = max(shown)
    moved, alone = found[newest]
    ever = {c.entry.name: c.entry for changes, _ in found.values() for c in changes}
    trend = {
        date: beside(information, entries[date], list(ever.values()))
        for date, (_, information) in shown.items()
        if len(shown) > 1
    }
    evidence = shown[newest][0]
    names = tuple(log.name for log in dated[newest])
    each: dict[str, Information] = {}  # what single logs say, of those that show motion
    for log in dated[newest] if len(names) > 1 else ():
        with suppress(LogError):
            each[log.name] = show([log])[1]
    apart = disagreement(each, [c.entry for c in alone], [c.entry for c in moved], tolerance)
    notes += [apart] if apart else []
    notes += too_short(alone, len(shown[newest][1].scores))
    rms, unit = evidence.torque_rms, evidence.unit
    return Check(moved, alone, rms, floor, unit, names, trend, tuple(notes))


def check_files(
    logs: Sequence[Path], model: Path, out: Path | None, *, tolerance: float, jobs: int
) -> Check:
    """Check log files, and write the result to a folder if there is to be one."""
    import matplotlib

    if not 0.0 <= tolerance <= 1.0:
        raise LogError(f"--tolerance {tolerance:g}: must lie between 0 and 1")
    if out is not None:
        check_folder(out)
    found = check(model, logs[0] if len(logs) == 1 else logs, tolerance=tolerance, jobs=jobs)
    if out is not None:
        matplotlib.use("Agg")  # no windows
        found.save(out)
    return found


def _shown(
    model: AnyModel,
    logs: Sequence[Log],
    *,
    errors: Mapping[str, float],
    bandwidth: float | None,
    jobs: int,
) -> tuple[Evidence, Information]:
    evidence = only_own(evidence_of(model, logs, jobs, bandwidth=bandwidth))
    return evidence, information_of(evidence, errors)


def date_of(name: str) -> datetime | None:
    """Date in the name of a log; None where there is none."""
    found = _DATE.search(name)
    if found is None:
        return None
    try:
        return datetime(*(int(part) for part in found.groups() if part))  # type: ignore[arg-type]
    except (ValueError, TypeError):
        return None


def _loaded(model: AnyModel, logs: Any) -> tuple[Sequence[Log], list[str]]:
    """Logs of the model's drive, and what was left out."""
    if isinstance(model, RigModel):
        notes: list[str] = []  # also of names in [data], which are those of the fitted logs
        return model.rig.read(logs, notes=notes), [t for t in notes if t.startswith(LEFT_OUT)]
    campaign = logs if isinstance(logs, Campaign) else load_logs(logs)
    return campaign, list(campaign.warnings)


def _recorded(file: Path) -> dict[str, Any]:
    """Content of a diagnosis.json; empty where there is none that can be read."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _errors(recorded: Mapping[str, Any]) -> dict[str, float]:
    """Standard errors by the keys of `evidence.Parameter`."""
    found = {}
    for name, entry in recorded.get("declared", {}).items():
        if isinstance(entry, dict) and entry.get("se"):
            found[name] = float(entry["se"])
    for effect in recorded.get("effects", []):
        for name, entry in effect.get("parameters", {}).items():
            if entry.get("se"):
                for owner in (effect["name"], f"{effect['name']}@{effect.get('location')}"):
                    found[f"{owner}.{name}"] = float(entry["se"])
    # what runs of the model moved, a balance of other logs gives otherwise as well
    apart = recorded.get("apart_from_balance", {})
    return {key: max(se, float(apart.get(key, 0.0))) for key, se in found.items()}


def _floor(recorded: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Torque error that the diagnosis left on held-out logs, and below how many hertz."""
    error = recorded.get("error", {})
    after = error.get("after", {})
    torque = after.get("torque")
    if isinstance(torque, dict):
        return torque.get("rmse"), torque.get("bandwidth_hz")
    return (after.get("rmse") if error.get("unit") in ("N", "N·m") else None), None


def _row(change: Change) -> dict[str, Any]:
    return {
        "name": change.entry.name,
        "value": change.entry.value,
        "change": change.change,
        "se": change.se,
        "unit": change.entry.unit or "1",
        "standard_errors": change.errors,
    }


def _series(trend: Mapping[datetime, list[Change]]) -> dict[str, list[tuple[float, float]]]:
    """Percent and standard error per date of the entries that the logs of every date show."""
    found: dict[str, list[tuple[float, float]]] = {}
    for changes in trend.values():
        for change in changes:
            size = change.entry.size
            row = (100.0 * change.change / size, 100.0 * change.se / size)
            found.setdefault(change.entry.name, []).append(row)
    return {name: rows for name, rows in found.items() if len(rows) == len(trend)}
