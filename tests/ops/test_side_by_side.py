"""Work side by side: every result at its place, shared threads, errors and settings kept."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from avatarrex.ops import side_by_side
from avatarrex.ops.native import threads as native_threads
from avatarrex.ops.native import torch_on_one_thread
from avatarrex.ops.side_by_side import SideBySide


@pytest.fixture(params=[1, 2, 4])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def test_each_result_belongs_to_its_work(threads):
    work = SideBySide()
    found = [work.add(lambda a, b=0: (a, b), k, b=10 * k) for k in range(9)]
    work.run()
    assert [future.result() for future in found] == [(k, 10 * k) for k in range(9)]
    assert torch.get_num_threads() == threads


def test_two_run_at_once_with_a_thread_each(threads):
    """Each waits for the other: one after the other they would never meet."""
    if threads == 1:
        pytest.skip("one thread")
    meeting = threading.Barrier(2, timeout=20)
    work = SideBySide()

    def meet() -> int:
        meeting.wait()
        return torch.get_num_threads()

    found = [work.add(meet) for _ in range(2)]
    work.run()
    assert [future.result() for future in found] == [1, 1]


def test_loops_keep_their_threads_while_torch_has_one(threads):
    """As in a frame: pieces still run at once, each with its share; one alone has them all."""
    with torch_on_one_thread():
        work = SideBySide()
        found = [work.add(native_threads) for _ in range(2)]
        work.run()
        alone = SideBySide()
        one = alone.add(native_threads)
        alone.run()
    assert [future.result() for future in found] == [max(threads // 2, 1)] * 2
    assert one.result() == threads


def test_one_piece_keeps_all_threads(threads):
    work = SideBySide()
    alone = work.add(torch.get_num_threads)
    work.run()
    assert alone.result() == threads


@pytest.mark.parametrize("gradients", [True, False])
def test_gradients_are_as_where_it_was_added(threads, gradients):
    work = SideBySide()
    with torch.set_grad_enabled(gradients):
        found = [work.add(torch.is_grad_enabled) for _ in range(4)]
    work.run()
    assert [future.result() for future in found] == [gradients] * 4


def test_an_error_is_raised_where_its_result_is_taken(threads):
    """The others are done all the same."""

    def fails() -> None:
        raise KeyError("this one")

    work = SideBySide()
    bad, good = work.add(fails), work.add(int, "7")
    work.run()
    assert good.result() == 7
    with pytest.raises(KeyError, match="this one"):
        bad.result()
    assert torch.get_num_threads() == threads


@pytest.mark.timeout(60)
def test_pieces_have_pieces_of_their_own() -> None:
    """Four pieces of four: nobody waits for a helper whose thread waits for it."""
    before = torch.get_num_threads()
    torch.set_num_threads(16)
    try:
        work = SideBySide()

        def several() -> list[int]:
            inner = SideBySide()
            found = [inner.add(lambda k: k, k) for k in range(4)]
            inner.run()
            return [future.result() for future in found]

        for _ in range(50):
            found = [work.add(several) for _ in range(4)]
            work.run()
            assert [future.result() for future in found] == [[0, 1, 2, 3]] * 4
    finally:
        torch.set_num_threads(before)


def test_threads_that_begin_later_have_as_many_as_before() -> None:
    """A helper that begins while the leader has set one takes that for what was there before."""
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        for turn in range(20):
            side_by_side._pool.cache_clear()  # its threads begin with this work
            work = SideBySide()
            for k in range(3):
                work.add(time.sleep, 0.004 * ((k + turn) % 3))
            work.run()
            with ThreadPoolExecutor(1) as later:
                assert later.submit(torch.get_num_threads).result() == 3
    finally:
        torch.set_num_threads(before)
