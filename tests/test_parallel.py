"""Threads that share out work: in order, never more at work than said, idle ones help."""

from threading import Barrier, Event, Lock, get_ident

import pytest

from dmptm_ctrl.parallel import in_threads, thread_pool


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_results_come_in_order_however_deep(jobs):
    def inner(i):
        return in_threads(lambda j: 10 * i + j, range(4), jobs)

    wanted = [[10 * i + j for j in range(4)] for i in range(3)]
    assert in_threads(inner, range(3), jobs) == wanted
    with thread_pool(jobs):
        assert in_threads(inner, range(3), jobs) == wanted


def test_two_are_at_work_at_once():
    met = Barrier(2, timeout=10.0)
    threads = in_threads(lambda _: (met.wait(), get_ident())[1], range(2), 2)
    assert len(set(threads)) == 2


def test_who_waits_for_another_helps_it():
    """One of two has nothing left to do: what the other one shares out takes both."""
    met, left = Barrier(2, timeout=10.0), Event()

    def first():
        left.set()

    def second():
        left.wait(10.0)
        for _ in range(10_000):  # until the other thread is seen to be idle
            seen = set(in_threads(lambda _: get_ident(), range(50), 2))
            if len(seen) > 1:
                return in_threads(lambda _: met.wait() >= 0, range(2), 2)
        return None

    assert in_threads(lambda own: own(), [first, second], 2) == [None, [True, True]]


def test_no_more_are_at_work_than_said():
    lock, busy, most = Lock(), [0], [0]

    def work(_):
        with lock:
            busy[0] += 1
            most[0] = max(most[0], busy[0])
        sum(range(20000))
        with lock:
            busy[0] -= 1

    with thread_pool(2):
        in_threads(lambda _: [work(k) for k in range(5)], range(40), 2)
    assert 1 <= most[0] <= 2


def test_an_error_is_the_caller_s():
    def fails(i):
        if i == 2:
            raise ValueError("two")
        return i

    with thread_pool(2):
        with pytest.raises(ValueError, match="two"):
            in_threads(fails, range(5), 2)
        assert in_threads(fails, range(2), 2) == [0, 1]  # and the threads go on
