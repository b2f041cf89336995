"""The queue of samples: in order, bounded, and indifferent to malformed ones."""

from typing import Any

import numpy as np
import pytest

from arm_emulator.view.rerun_batches import SampleQueue


def test_queue_keeps_order_and_counts_what_finds_no_place() -> None:
    queue = SampleQueue(capacity=8, width=2, joints=3)
    values = np.zeros((2, 3))
    for k in range(11):
        values[:] = [[k], [-k]]  # the writer's arrays are its own again at once
        queue.put(k, (values[0], values[1]))
    assert (len(queue), queue.dropped, queue.newest) == (8, 3, 7)
    times, rows = queue.take(5)
    assert times.tolist() == [0, 1, 2, 3, 4]  # the oldest are kept
    assert rows.tolist() == [[[k] * 3, [-k] * 3] for k in range(5)]
    queue.put(20, (values[0], values[1]))
    assert queue.take(100)[0].tolist() == [5, 6, 7, 20]
    assert queue.take(100)[1].shape == (0, 2, 3)
    assert queue.dropped == 3


@pytest.mark.parametrize(
    ("time_ns", "quantities"),
    [
        (0, (np.zeros(3), np.zeros(2))),
        (0, (np.zeros(4), np.zeros(4))),
        (0, (np.zeros(3),)),
        (0, (np.zeros(3), 1.0)),
        (0, None),
        (0, (np.array(["a", "b", "c"]), np.zeros(3))),
        ("now", (np.zeros(3), np.zeros(3))),
        (2**80, (np.zeros(3), np.zeros(3))),
        ([1, 2], (np.zeros(3), np.zeros(3))),
    ],
)
def test_a_malformed_sample_is_dropped_alone(time_ns: Any, quantities: Any) -> None:
    queue = SampleQueue(capacity=4, width=2, joints=3)
    queue.put(1, (np.arange(3), np.arange(3)))  # whole numbers will do
    queue.put(time_ns, quantities)
    queue.put(5, (np.ones(3), np.ones(3)))
    times, rows = queue.take(4)
    assert times.tolist() == [1, 5]
    assert rows.tolist() == [[[0, 1, 2]] * 2, [[1, 1, 1]] * 2]
    assert queue.dropped == 1
    queue.put(time_ns, quantities)
    assert queue.take(4)[1].shape == (0, 2, 3)
    assert queue.dropped == 2
