"""TOML from files that people edit: whatever is wrong with one is a LogError."""

import tomllib
from pathlib import Path
from typing import Any

from dmptm_ctrl.signals.errors import LogError

WHOLE = 1 << 63  # whole numbers of TOML have 64 bits; Python's would overflow a float later


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Read TOML; LogError if it is none, nested too deeply, or has a number of over 64 bits."""
    try:
        data = tomllib.loads(text.removeprefix("\ufeff"))  # Windows marks UTF-8
    except tomllib.TOMLDecodeError as error:
        raise LogError(f"{source}: not TOML: {error}") from None
    except RecursionError:
        raise LogError(f"{source}: not TOML of any use: brackets nested too deeply") from None
    except ValueError:  # of int(), which refuses to read thousands of digits
        raise LogError(f"{source}: a whole number has more than 64 bits") from None
    left: list[Any] = [data]
    while left:
        item = left.pop()
        if isinstance(item, dict):
            left += item.values()
        elif isinstance(item, list):
            left += item
        elif isinstance(item, int) and not -WHOLE <= item < WHOLE:
            raise LogError(f"{source}: a whole number has more than 64 bits")
    return data


def read_toml(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """Read a file of TOML: its text, and its data as of `parse_toml`; `what` it should be."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise LogError(f"{path.name}: no readable {what} file there") from None
    return text, parse_toml(text, path.name)
