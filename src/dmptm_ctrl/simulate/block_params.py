"""The `params` of a block simulation: values of a model and its loop, by name."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.plain import Sites

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model


def refuse_unknown(params: Iterable[str], known: Sequence[str], others: Sequence[str]) -> None:
    """Refuse names of `params` that are neither of the blocks nor of others beside them.

    python-control hands the params of every block to all blocks of a system.

    Raises
    ------
    ValueError
    """
    for name in params:
        if name not in known and name not in others:
            raise ValueError(
                f"params: the blocks have no {name!r}; they have {', '.join(known)}; an effect "
                "belongs to model.with_effect(…); if it is of a block of your own, build ours "
                f"with others=({name!r},)"
            )


class Given:
    """A model and its loop, with values replaced by the `params` of a simulation."""

    def __init__(
        self, model: "Model | None", loop: Loop | None = None, others: Sequence[str] = ()
    ) -> None:
        self.model, self.loop, self.others = model, loop, others
        self.sites = None if model is None else Sites(model)
        self._names = (
            *(() if model is None else model.drive),
            *(() if loop is None else Loop._fields),
        )
        self._varied: dict[tuple[tuple[str, float], ...], Given] = {}

    def at(self, params: Mapping[str, float]) -> Any:
        """Return it with the values of `params`.

        Raises
        ------
        ValueError
            A name that neither the drive nor the loop has, or a value that no drive has.
        """
        if not params:
            return self
        key = tuple(sorted(params.items()))
        if key not in self._varied:
            refuse_unknown(params, self._names, self.others)
            model, loop = self.model, self.loop
            if model is not None:
                model = model.with_values(**{k: v for k, v in key if k in model.drive})
            if loop is not None:
                loop = loop._replace(**{k: v for k, v in key if k in Loop._fields})
            self._varied[key] = Given(model, loop)
        return self._varied[key]


def given_of(model: "Model | Given") -> Any:
    """Return a model as blocks take it."""
    return model if isinstance(model, Given) else Given(model)
