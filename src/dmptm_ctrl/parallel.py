"""Tasks of a study on joblib's backend: threads, processes, or a cluster."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal


def each(
    function: Callable[..., Any],
    tasks: Iterable[tuple[Any, ...]],
    n_jobs: int | None = None,
    *,
    prefer: Literal["processes", "threads"] | None = None,
    in_order: bool = True,
) -> Iterator[Any]:
    """Call a function for each task where ``joblib.parallel_config`` says, and yield as ready.

    Parameters
    ----------
    function : callable
    tasks : iterable of tuple
        Arguments of each call.
    n_jobs : int, optional
        Of joblib: −1 for one per core; by default one, or what ``parallel_config`` says.
    prefer : "processes" or "threads", optional
        Where to run if ``parallel_config`` does not say.
    in_order : bool
        Yield in the order of `tasks`, else as they get ready.

    Yields
    ------
    What `function` returns.
    """
    from joblib import Parallel, delayed

    return_as = "generator" if in_order else "generator_unordered"
    parallel = Parallel(n_jobs=n_jobs, prefer=prefer, return_as=return_as)
    yield from parallel(delayed(_call)(function, task) for task in tasks)


def _call(function: Callable[..., Any], task: tuple[Any, ...]) -> Any:
    """Call with the arguments in one tuple.

    joblib's Dask backend lays large arguments on one worker, where they are lost with it;
    a tuple stays with its task, which the scheduler gives to another worker.
    """
    return function(*task)
