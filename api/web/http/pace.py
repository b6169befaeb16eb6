"""Average rate of a client's messages."""

import time


class Pace:
    """Average rate of messages, with a second's messages at once at most."""

    def __init__(self, per_s: float) -> None:
        self._per_s, self._left, self._at_s = per_s, max(per_s, 1.0), time.monotonic()

    def has_room(self) -> bool:
        """Count a message, unless it is above the rate; return whether it is within."""
        now_s = time.monotonic()
        self._left = min(max(self._per_s, 1.0), self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
