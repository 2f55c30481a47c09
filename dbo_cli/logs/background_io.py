"""Reading one block ahead and writing one block behind, so that parsing, mathematics and formatting overlap.

Only for regular files: a thread that waits for a pipe could not be interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")


def one_ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Give the items of an iterator, each made in a thread while the one before is worked on.

    None is none of them. An exception of the iterator is raised here, after the items before it.
    """
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        coming: Future[Item | None] = pool.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = pool.submit(next, items, None)
            yield item


class OneBehind:
    """Runs calls in a thread, one after the other; each waits for the one before and raises its exception."""

    def __init__(self) -> None:
        from concurrent.futures import ThreadPoolExecutor

        self._pool = ThreadPoolExecutor(1)
        self._running: Future[Any] | None = None

    def run(self, call: Callable[..., object], *arguments: object) -> None:
        """Start a call once the one before is done."""
        if self._running is not None:
            self._running.result()
        self._running = self._pool.submit(call, *arguments)

    def wait(self) -> None:
        """Wait for the running call."""
        if self._running is not None:
            running, self._running = self._running, None
            running.result()

    def close(self) -> None:
        """End the thread when its call is done, whatever came of it."""
        self._pool.shutdown()
