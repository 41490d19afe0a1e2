"""What can be wrong with a log, or keep it from being read."""

from collections import Counter
from collections.abc import Iterable
from importlib import import_module
from typing import Any


class LogError(ValueError):
    """A log cannot be used; the message says what, where and what would be right."""


class MissingChannelError(LogError, KeyError):
    """A log has no channel of that name."""

    __str__ = ValueError.__str__  # KeyError would print the message in quotes


class NotALogError(LogError):
    """A file that is no log at all: empty, too short, notes, a picture."""


class ColumnsError(NotALogError):
    """A table of numbers whose columns do not say which channels they are."""


def repeated(names: Iterable[str]) -> str | None:
    """Return the first name that occurs again, None if none does."""
    return next((name for name, count in Counter(names).items() if count > 1), None)


def optional(module: str, what: str, extra: str) -> Any:
    """Return a module of an extra that `what` needs; ImportError says how to install it."""
    library = module.partition(".")[0]
    try:
        import_module(library)
        return import_module(module)
    except ImportError:
        raise ImportError(f"{what} need {library}: pip install 'dmptm-ctrl[{extra}]'") from None
