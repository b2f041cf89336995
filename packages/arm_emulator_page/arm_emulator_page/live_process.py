"""The process that serves the page of a running machine, see `arm_emulator.page.page_process`.

It ends when its input does: the run is over, however it ended.
"""

import sys
import traceback

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.page import Controls, RowEnd, SharedRing
from arm_emulator_page.live_page import LivePage

FRAME = 0.05  # s, wall, between two pictures
GRACE = 3.0  # s, wall: nothing is lost by its end


def main() -> None:
    """Serve the page until the run is over; hand the run the page's address at first."""
    end = RowEnd(niceness=10, grace=GRACE)
    task = end.task
    try:
        ring = SharedRing(task["memory"], task["kind"])
        controls: Controls = task["hands"]()
        page = LivePage(
            task["scene"], task["columns"], task["kind"], controls, task["at"], task["varied"]
        )
    except Refusal as no:
        end.send_last_answer(no)
    end.send_answer(page.url)
    _show_all(end, ring, page)
    end.end_in_time()
    controls.close()
    page.close()
    end.send_last_answer("")


def _show_all(end: RowEnd, ring: SharedRing, page: LivePage) -> None:
    """Show rows until the run is over, in any state of a browser's controls."""
    reported = ""
    while not end.is_over(FRAME):
        page.take_rows(ring.take_rows(), ring.dropped)
        try:
            page.draw_rows()
        except Exception as error:
            if reported != (reported := repr(error)):
                print("page: not drawn", traceback.format_exc(), sep="\n", file=sys.stderr)


if __name__ == "__main__":
    main()
