"""Going on only as long as the run is to go on."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

__all__ = ["Tell", "Waiting", "silent"]

_STEP: Final = 0.5
"""Seconds between two looks whether to stop."""


Tell = Callable[[str, int, int | None], None]
"""Takes what is being done, how much of it is done, and of how much; None while that is unknown."""


def silent(_text: str, _done: int, _total: int | None) -> None:
    """Tell nobody."""


class Waiting:
    """Ends what takes long, soon after it is asked to.

    Parameters
    ----------
    stop : callable
        Whether the run is to stop.
    """

    def __init__(self, stop: Callable[[], bool] = lambda: False) -> None:
        self._stop = stop

    def check(self) -> None:
        """Go on, or not.

        Raises
        ------
        KeyboardInterrupt
            If the run is to stop: there is nothing yet that a softer end would save.
        """
        if self._stop():
            raise KeyboardInterrupt

    def wait(self, seconds: float) -> None:
        """Wait, unless `check` says otherwise meanwhile."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, _STEP))
