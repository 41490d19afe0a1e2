"""Responses whose numbers are there before python-control is.

To import python-control takes several times as long as a run. A process that has not done so,
and asks a response for its numbers only, need not wait: the response becomes python-control's
own the moment it is asked for anything else.
"""

import sys
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from numpy.typing import NDArray

if TYPE_CHECKING:
    import control


def response(time: NDArray[Any], outputs: NDArray[Any], **given: Any) -> "control.TimeResponseData":
    """Return what ``control.TimeResponseData(time, outputs, **given)`` is.

    `inputs`, an (m, n) array, is among what is `given`.
    """
    given = {"issiso": False, **given}
    if "control" in sys.modules:
        from control import TimeResponseData

        return TimeResponseData(time, outputs, **given)
    return cast("control.TimeResponseData", _Response(time, outputs, given))


class _Response:
    """A response as long as its numbers are enough; a TimeResponseData from then on."""

    def __init__(self, time: NDArray[Any], outputs: NDArray[Any], given: dict[str, Any]) -> None:
        numbers = {"time": time, "outputs": outputs, "inputs": given["inputs"]}
        raw = {"t": time, "y": outputs, "u": given["inputs"]}
        self.__dict__.update(numbers, **raw, _given=given)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # a protocol that no object needs to have
            raise AttributeError(name)
        return getattr(_made(self), name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(_made(self), name, value)

    @property  # type: ignore[misc]
    def __class__(self) -> type:  # asked for by isinstance, which sees no change of class itself
        from control import TimeResponseData

        return TimeResponseData

    def __iter__(self) -> Any:
        return iter(_made(self))

    def __getitem__(self, key: Any) -> Any:
        return _made(self)[key]

    def __len__(self) -> int:
        return len(_made(self))

    def __call__(self, **kwargs: Any) -> Any:
        return _made(self)(**kwargs)

    def __repr__(self) -> str:
        return repr(_made(self))

    def __reduce__(self) -> Any:
        return partial(response, **self._given), (self.time, self.outputs)


def _made(one: Any) -> Any:
    """Make a response what it stands for, in its place; whoever holds it holds that."""
    from control import TimeResponseData

    if type(one) is _Response:
        time, outputs, given = one.time, one.outputs, one._given
        one.__dict__.clear()
        # not by assignment: that would ask the property above
        object.__dict__["__class__"].__set__(one, TimeResponseData)
        TimeResponseData.__init__(one, time, outputs, **given)
    return one
