"""The part of diagnosis.json that every kind of drive has."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

SCHEMA = 1


class _Entry(Protocol):
    def to_dict(self) -> dict[str, Any]: ...


def verdict_dict(
    verdict: str,
    effects: Iterable[_Entry],
    *,
    ranking: Sequence[Mapping[str, Any]],
    depends_on: Iterable[str],
    error: Mapping[str, Any],
    provenance: Mapping[str, Any],
    warnings: Iterable[str],
    **more: Any,
) -> dict[str, Any]:
    """Return the content of diagnosis.json: plain types, no NaN; `more` besides."""
    return {
        "schema": SCHEMA,
        "verdict": verdict,
        "effects": [effect.to_dict() for effect in effects],
        "ranking": ranking,
        "depends_on": list(depends_on),
        "error": error,
        **more,
        "provenance": provenance,
        "warnings": list(warnings),
    }
