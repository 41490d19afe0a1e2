"""What can be wrong with a log."""


class LogError(ValueError):
    """A log cannot be used; the message says what, where and what would be right."""


class MissingChannelError(LogError, KeyError):
    """A log has no channel of that name."""

    __str__ = ValueError.__str__  # KeyError would print the message in quotes


class NotALogError(LogError):
    """A file that is no log at all: empty, too short, notes, a picture."""


class ColumnsError(NotALogError):
    """A table of numbers whose columns do not say which channels they are."""
