"""A log: signals on one clock, measured or simulated, in SI units and radians."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.signals.errors import LogError, MissingChannelError
from dmptm_ctrl.signals.units import door_column, expected_symbol

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

# Time stamps within this share of a step of an even grid are even: text files round them.
EVEN_TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class Log:
    """Signals on one clock, measured or simulated.

    Parameters
    ----------
    name : str
        What people call it, as a rule the file's name without its extension.
    time : (n,) array_like [s]
        Strictly increasing.
    channels : mapping of str to (n,) array_like
        In SI and radians: ``u_left``, ``u_right`` [V]; ``theta_L``, ``theta_ml``,
        ``theta_mr`` [rad]; ``omega_L``, ``ref`` [rad/s]; other drives name theirs freely.
    sha256 : str, optional
        Of the file it came from.
    meta : mapping, optional
        Anything else worth keeping, such as the file's own description.
    units : mapping of str to str, optional
        SI symbol of each channel; those of the channels above are known.
    warnings : tuple of str
        What is suspect but does not forbid use.

    Raises
    ------
    LogError
        Lengths differ, a value is not finite, time does not increase.

    Notes
    -----
    Arrays are copied and read-only. A log compares equal only to itself.

    Examples
    --------
    >>> time = np.arange(0.0, 1.0, 1e-3)
    >>> log = dm.Log("run 7", time, {"u_left": 0.0 * time, "omega_L": np.sin(time)})
    """

    name: str
    time: Array
    channels: Mapping[str, Array]
    sha256: str | None = None
    meta: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("channels", "units"):
            if not isinstance(getattr(self, name), Mapping):
                kind = type(getattr(self, name)).__name__
                raise TypeError(f"{name} of a Log must be a mapping by channel, not a {kind}")
        time = _read_only("time", self.time)
        if time.size == 0:
            raise LogError(f"{self.name}: the log is empty")
        channels = {}
        for channel, values in self.channels.items():
            channels[channel] = _read_only(channel, values)
            if channels[channel].shape != time.shape:
                raise LogError(
                    f"{self.name}: {channel} has {channels[channel].size} samples, "
                    f"time has {time.size}"
                )
        for channel, values in {"time": time, **channels}.items():
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values))[0])
                raise LogError(f"{self.name}: {channel} is {values[row]} in row {row + 1}")
        if not (np.diff(time) > 0).all():
            row = int(np.flatnonzero(np.diff(time) <= 0)[0]) + 1
            raise LogError(
                f"{self.name}: time does not increase in row {row + 1} "
                f"({time[row - 1]:.6g} s, then {time[row]:.6g} s)"
            )
        units = {c: self.units.get(c) or expected_symbol(c) or "" for c in channels}
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        object.__setattr__(self, "units", MappingProxyType(units))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))
        object.__setattr__(self, "warnings", tuple(self.warnings))

    def __reduce__(self) -> tuple[Any, ...]:
        # mapping proxies do not pickle; joblib sends logs to its workers
        plain = dict(self.channels), self.sha256, dict(self.meta), dict(self.units)
        return type(self), (self.name, self.time, *plain, self.warnings)

    def __getitem__(self, channel: str) -> Array:
        """Samples of a channel, (n,), SI; ``"time"`` works too."""
        if channel == "time":
            return self.time
        try:
            return self.channels[channel]
        except KeyError:
            raise MissingChannelError(
                f"{self.name}: no channel {channel!r}; it has {', '.join(self.channels)}"
            ) from None

    def __contains__(self, channel: object) -> bool:
        return channel in self.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        return (
            f"<Log {self.name}: {len(self)} samples, {self.duration:.6g} s, "
            f"{', '.join(self.channels)}>"
        )

    def has(self, *channels: str) -> bool:
        """Whether the log has all of these channels."""
        return all(channel in self.channels for channel in channels)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def sample_time(self) -> float:
        """Time between samples [s].

        Raises
        ------
        LogError
            One sample only, or steps that are not even.
        """
        if len(self) < 2:
            raise LogError(f"{self.name}: one sample has no sample time")
        mean = self.duration / (len(self) - 1)
        if not is_even(self.time):
            step = np.diff(self.time)
            raise LogError(
                f"{self.name}: uneven time, steps {step.min():.6g} to {step.max():.6g} s"
            )
        # 1 ms read from decimal text comes out as 0.00099999999999999…
        return float(f"{mean:.12g}")

    def segment(self, start: float, stop: float) -> "Log":
        """Samples with start <= time <= stop [s], on the same clock.

        Raises
        ------
        LogError
            No sample lies between.
        """
        inside = (self.time >= start) & (self.time <= stop)
        if not inside.any():
            raise LogError(
                f"{self.name}: no sample from {start:.6g} to {stop:.6g} s, the log runs from "
                f"{self.time[0]:.6g} to {self.time[-1]:.6g} s"
            )
        channels = {channel: values[inside] for channel, values in self.channels.items()}
        return replace(self, time=self.time[inside], channels=channels)

    def with_channels(self, **channels: ArrayLike) -> "Log":
        """Copy with channels added or replaced (SI)."""
        added = {channel: _read_only(channel, values) for channel, values in channels.items()}
        return replace(self, channels={**self.channels, **added})

    def to_frame(self, *, degrees: bool = True) -> "pd.DataFrame":
        """Table with the unit in each column's name, ready for ``to_csv``.

        Parameters
        ----------
        degrees : bool
            Angles and angular speeds in degrees; else radians.

        Returns
        -------
        DataFrame
            ``time_s`` first, one row per sample.
        """
        import pandas as pd

        columns = {"time_s": self.time}
        for channel, values in self.channels.items():
            column, factor = door_column(channel, self.units[channel], degrees=degrees)
            columns[column] = values / factor
        return pd.DataFrame(columns)

    def _repr_html_(self) -> str:
        table = self.to_frame().agg(["min", "max"]).T.to_html(float_format="{:.5g}".format)
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.warnings)
        about = f"<b>{escape(self.name)}</b>: {len(self)} samples, {self.duration:.6g} s"
        return f"{about}{table}<ul>{notes}</ul>"


def is_even(time: Array) -> bool:
    """Whether a clock runs forwards in equal steps, but for what rounding of stamps makes."""
    step = np.diff(time)
    mean = (time[-1] - time[0]) / step.size
    grid = time[0] + mean * np.arange(time.size)
    return bool((step > 0).all() and np.abs(time - grid).max() <= EVEN_TOLERANCE * mean)


def _read_only(name: str, values: ArrayLike) -> Array:
    """Float array that nobody can write to; copies unless it already is one."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise LogError(f"{name} is not an array of numbers") from error
    if array.ndim != 1:
        raise LogError(f"{name} has shape {array.shape}, a channel has one axis")
    if array.flags.writeable or array.base is not None:
        array = array.copy()
        array.flags.writeable = False
    return array
