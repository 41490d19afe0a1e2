"""Tasks of a study on joblib's backend: threads, processes, or a cluster."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import wraps
from threading import Condition, local
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


def in_threads(
    function: Callable[[T], R],
    items: Iterable[T],
    jobs: int,
    size: Callable[[T], float] | None = None,
) -> list[R]:
    """Call a function, most of which is compiled, for each item, at once on `jobs` threads.

    On one of them what is called does its own one after another, the cores are taken, unless
    others of them have nothing left to do. By `size` the largest begin first: none is left for
    one core alone.
    """
    items = list(items)
    if min(jobs, len(items)) <= 1:
        return [function(item) for item in items]
    with thread_pool(jobs):
        if size is None:
            return _THREAD.thread_pool.share(function, items)
        order = sorted(range(len(items)), key=lambda i: -size(items[i]))
        shared = _THREAD.thread_pool.share(function, [items[i] for i in order])
        done = dict(zip(order, shared, strict=True))
        return [done[i] for i in range(len(items))]


@contextmanager
def thread_pool(jobs: int) -> Iterator[None]:
    """Keep threads for all that this one shares out; begun anew for each takes as long as a run."""
    if jobs <= 1 or getattr(_THREAD, "thread_pool", None) is not None:
        yield
        return
    own = _THREAD.thread_pool = _Pool(jobs)
    try:
        with own.pool:
            yield
    finally:
        _THREAD.thread_pool = None


class _Pool:
    """Threads that help each other; no more than so many are at work."""

    def __init__(self, jobs: int) -> None:
        self.idle, self.changed = jobs - 1, Condition()
        # one more than helpers: while one waits for another, a third may help that
        self.pool = ThreadPoolExecutor(jobs, "thread_pool", setattr, (_THREAD, "thread_pool", self))

    def share(self, function: Callable[[T], R], items: list[T]) -> list[R]:
        """Call a function for each item, on this thread and idle ones; none waits untaken."""
        if self.idle <= 0:
            return [function(item) for item in items]
        others = [self.pool.submit(self._help, function, item) for item in items[1:]]
        try:
            done = {0: function(items[0])}
            done |= {i: function(items[i]) for i, one in enumerate(others, 1) if one.cancel()}
            if len(done) < len(items):
                self._rest()
                try:
                    done |= {i: one.result() for i, one in enumerate(others, 1) if i not in done}
                finally:
                    self._work()
            return [done[i] for i in range(len(items))]
        finally:
            for one in others:
                one.cancel()

    def _help(self, function: Callable[[T], R], item: T) -> R:
        self._work()
        try:
            return function(item)
        finally:
            self._rest()

    def _work(self) -> None:
        with self.changed:
            self.changed.wait_for(lambda: self.idle > 0)
            self.idle -= 1

    def _rest(self) -> None:
        with self.changed:
            self.idle += 1
            self.changed.notify()


def each(
    function: Callable[..., Any],
    tasks: Iterable[tuple[Any, ...]],
    jobs: int | None = None,
    *,
    prefer: Literal["processes", "threads"] | None = None,
    in_order: bool = True,
) -> Iterator[Any]:
    """Call a function for each task where ``joblib.parallel_config`` says, and yield as ready.

    `jobs` is joblib's; `prefer` says where to run if ``parallel_config`` does not.
    Results come in the order of `tasks`, or as they get ready.
    """
    from joblib import Parallel, delayed

    return_as = "generator" if in_order else "generator_unordered"
    parallel = Parallel(n_jobs=jobs, prefer=prefer, return_as=return_as)
    yield from parallel(delayed(_call)(function, task) for task in tasks)


def _call(function: Callable[..., Any], task: tuple[Any, ...]) -> Any:
    """Call with arguments in a tuple: Dask lays large ones on a worker, and loses both."""
    return function(*task)
