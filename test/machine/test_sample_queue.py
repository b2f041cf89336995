"""The queue of samples: in order, and bounded."""

import numpy as np

from arm_emulator.view.rerun_batches import SampleQueue


def test_queue_keeps_order_and_counts_messages_without_a_place() -> None:
    queue = SampleQueue(capacity=8, width=2, joints=3)
    values = np.zeros((2, 3))
    for k in range(11):
        values[:] = [[k], [-k]]  # the writer's arrays are its own again at once
        queue.append_sample(k, (values[0], values[1]))
    assert (len(queue), queue.dropped, queue.newest) == (8, 3, 7)
    times, rows = queue.take_samples(5)
    assert times.tolist() == [0, 1, 2, 3, 4]  # the oldest are kept
    assert rows.tolist() == [[[k] * 3, [-k] * 3] for k in range(5)]
    queue.append_sample(20, (values[0], values[1]))
    assert queue.take_samples(100)[0].tolist() == [5, 6, 7, 20]
    assert queue.take_samples(100)[1].shape == (0, 2, 3)
    assert queue.dropped == 3
