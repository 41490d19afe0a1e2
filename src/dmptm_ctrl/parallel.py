"""Tasks of a study on joblib's backend: threads, processes, or a cluster."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from threading import local
from typing import Any, Literal, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
_THREAD = local()


def small_matrices(function: Callable[P, R]) -> Callable[P, R]:
    """Let the linear algebra of a function run on one thread.

    Its matrices have some tens of rows: threads would wait for each other, and for those that
    share out the work here, and sums would be rounded by how many cores there are.
    """

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return alone


def in_threads(function: Callable[[T], R], items: Iterable[T], jobs: int) -> list[R]:
    """Call a function, most of which is compiled, for each item, at once on `jobs` threads.

    On one of them what is called does its own one after another: the cores are taken.
    """
    items = list(items)
    if min(jobs, len(items)) <= 1 or getattr(_THREAD, "taken", False):
        return [function(item) for item in items]
    with ThreadPoolExecutor(jobs, initializer=setattr, initargs=(_THREAD, "taken", True)) as pool:
        return list(pool.map(function, items))


def at_once(first: Callable[[], T], second: Callable[[], R], jobs: int) -> tuple[T, R]:
    """Call one function on threads of its own while another runs alone; `second` on one core."""
    if jobs <= 1:
        return first(), second()
    with ThreadPoolExecutor(1) as other:
        coming = other.submit(second)
        return first(), coming.result()


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
